/* What both versions of FMI share: an instance of the valve, its phases, its variables and its messages. */
#ifndef FMI_INSTANCE_H
#define FMI_INSTANCE_H

#include "valve.h"

/* Value references: the block, then the place in the valve's tables. */
#define REF_TIME 0u
#define REF_PARAMETER 1000u
#define REF_INPUT 2000u
#define REF_STATE 3000u
#define REF_DERIVATIVE 4000u
#define REF_OUTPUT 5000u
#define REF_BLOCK 1000u

typedef enum {
    PHASE_INSTANTIATED = 1,
    PHASE_INITIALIZATION = 2,
    PHASE_EVENT = 4,      /* model exchange */
    PHASE_CONTINUOUS = 8, /* model exchange */
    PHASE_STEP = 16,      /* co-simulation */
    PHASE_TERMINATED = 32
} Phase;
#define PHASES_ALL (63)
#define PHASES_RUN (PHASE_EVENT | PHASE_CONTINUOUS | PHASE_STEP)

typedef enum { GOOD = 0, DISCARDED = 1, BAD = 2 } Outcome;

typedef struct {
    Valve valve;
    Phase phase;
    int co_simulation;
    int settled;  /* the state at rest belongs to parameters and inputs: before the run */
    int stop_defined;
    double stop;
    double last_step; /* end of the last communication step that was done */
} Run; /* all that a saved state of the FMU holds */

typedef struct {
    Run run;
    void *environment;
    void (*tell)(void *instance, Outcome outcome, const char *message);
    char message[400];
    char name[100];
    int logging;
    int inside_step; /* a step is under way: the importer is called back */
    void *functions; /* of the importer, by version */
} Instance;

Outcome instance_fail(Instance *instance, Outcome outcome, const char *format, ...);
Outcome instance_in_phase(Instance *instance, int phases, const char *function);
Outcome instance_status(Instance *instance, ValveStatus status);
void instance_reset(Instance *instance);
Outcome instance_settle(Instance *instance);
Outcome instance_get(Instance *instance, unsigned reference, double *value);
Outcome instance_set(Instance *instance, unsigned reference, double value);
Outcome instance_set_time(Instance *instance, double time);
Outcome instance_set_states(Instance *instance, const double states[], size_t count);
Outcome instance_rates(Instance *instance, double rates[], size_t count);
Outcome instance_update(Instance *instance, int *states_changed);
Outcome instance_tolerance(Instance *instance, int defined, double tolerance);
Outcome instance_check_step(Instance *instance, double point, double size);
Outcome instance_directional(Instance *instance, const unsigned unknowns[], size_t unknown_count,
                             const unsigned knowns[], size_t known_count, const double seed[], double sensitivity[]);
Outcome instance_adjoint(Instance *instance, const unsigned unknowns[], size_t unknown_count, const unsigned knowns[],
                         size_t known_count, const double seed[], double sensitivity[]);
Outcome instance_output_rates(Instance *instance, const unsigned references[], size_t count, double rates[]);

/* A saved state as bytes, with a head by which a foreign one is refused. */
size_t instance_serialized_size(void);
Outcome instance_serialize(Instance *instance, const Run *run, unsigned char bytes[], size_t size);
Outcome instance_deserialize(Instance *instance, const unsigned char bytes[], size_t size, Run *run);

#endif
