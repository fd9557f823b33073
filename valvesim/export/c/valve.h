/* A servo valve over time and temperature, as plain C99: nothing beyond the C library and its mathematics is needed.
 *
 *     Valve valve;
 *     valve_defaults(&valve);                                  every parameter and input at its start value
 *     valve.inputs[VALVE_INPUT_COMMAND] = 2e-3;                the names stand in valve_model.h; SI units, degrees C
 *     status = valve_start(&valve);                            the valve at rest under its inputs
 *     status = valve_advance(&valve, 1e-3, NULL);              one millisecond on, with error control, or
 *     status = valve_advance_fixed(&valve, 1e-3, 20);          the same in 20 equal steps, of known cost
 *     status = valve_outputs(&valve, outputs);                 everything else that is told
 *
 * A Valve is plain data: copying it keeps a state to return to. No function allocates, keeps anything between calls
 * or writes outside of what it is given. A status other than VALVE_OK says what is wrong, and valve.culprit which
 * variable it is about (valve_describe puts both into words); the states are then those of the last good step.
 */
#ifndef VALVE_H
#define VALVE_H

#include <stddef.h>

#include "valve_model.h"

#define VALVE_ORDERS 3 /* derivatives of the inputs over time that are followed within an advance */
#define VALVE_SLOW (VALVE_STATES - VALVE_COUPLED) /* temperatures among the states */
#define VALVE_SLOW_ROOM (VALVE_SLOW + 1) /* no array of length zero */
#define VALVE_STATE_ROOM (VALVE_COUPLED + VALVE_SLOW_ROOM)

typedef enum {
    VALVE_OK = 0,
    VALVE_PARAMETER_RANGE,   /* culprit: index of a parameter that is no number or beyond its bounds */
    VALVE_INPUT_RANGE,       /* culprit: index of an input that is no number or beyond its bounds */
    VALVE_STATE_RANGE,       /* culprit: index of a state that is no number */
    VALVE_RETURN_PRESSURE,   /* the return pressure is not below the supply pressure */
    VALVE_LOAD_PRESSURE,     /* the load pressure is beyond the supply pressure */
    VALVE_CLEARANCE_CLOSED,  /* culprit: index of a coefficient, a clearance that temperature or a parameter closes */
    VALVE_NO_COEFFICIENT,    /* culprit: index of a coefficient that is no number */
    VALVE_NULL_UNSTABLE,     /* at zero current the flapper does not rest between the nozzles */
    VALVE_NO_REST,           /* no state is at rest under the inputs; culprit: the state that stays in motion */
    VALVE_TOO_MANY_STEPS,    /* culprit: the state that moves fastest */
    VALVE_STEP_TOO_SMALL,    /* culprit: the state that moves fastest */
    VALVE_NOT_FINITE,        /* a fixed step left the range of numbers; culprit: the state */
    VALVE_DURATION           /* the duration (1 ps or more) or the count of steps is not positive and finite */
} ValveStatus;

typedef struct {
    double parameters[VALVE_PARAMETERS];
    double inputs[VALVE_INPUTS];
    double slopes[VALVE_ORDERS][VALVE_INPUTS]; /* first and higher derivatives of the inputs, from now on */
    double states[VALVE_STATE_ROOM];
    double time;      /* s, since the start; for the caller's use and for messages */
    double tolerance; /* relative error of a step */

    /* what follows the valve keeps for itself */
    double coefficients[VALVE_COEFFICIENTS]; /* at the parameters, the temperatures and the oil */
    double prepared[VALVE_PREPARED];         /* what the equations make of them, once and for all states */
    double rest[VALVE_COUPLED];              /* scaled states at the start, from which errors are measured */
    double step;                             /* s, what the error control wants next */
    double command_before;                   /* command at the end of the last advance */
    double accepted, rejected;               /* steps so far */
    double propagator_step;                  /* s, of the propagator below; zero: none */
    double transition[VALVE_SLOW_ROOM][VALVE_SLOW_ROOM + 3]; /* temperatures a propagator step on */
    int culprit;
    int coefficients_valid;
} Valve;

/* What goes on inside an advance; any member may be NULL. Times are seconds since the advance began. */
typedef struct {
    void *context;
    void (*inputs_at)(void *context, double time, double inputs[VALVE_INPUTS]); /* in place of inputs and slopes */
    int (*step_done)(void *context, double time, const double states[VALVE_STATES],
                     const double inputs[VALVE_INPUTS]); /* a step inside is done, valve is as it is then; not 0: stop */
} ValveHooks;

void valve_defaults(Valve *valve);
ValveStatus valve_check(Valve *valve);
ValveStatus valve_start(Valve *valve);
ValveStatus valve_advance(Valve *valve, double duration, const ValveHooks *hooks);
ValveStatus valve_advance_fixed(Valve *valve, double duration, int steps);
ValveStatus valve_pass_jump(Valve *valve);
ValveStatus valve_rates(Valve *valve, double rates[VALVE_STATE_ROOM]);
ValveStatus valve_outputs(Valve *valve, double outputs[VALVE_OUTPUTS]);

/* After a change of parameters, states or the oil's temperature by the caller: coefficients are worked out anew. */
void valve_parameters_changed(Valve *valve);
void valve_temperatures_changed(Valve *valve);

/* In words, at most `size` characters with the closing zero. */
void valve_describe(const Valve *valve, ValveStatus status, char text[], size_t size);

/* Between the files of this model. */
ValveStatus valve_refresh(Valve *valve);
ValveStatus valve_coefficients_at(Valve *valve, const double temperatures[], const double inputs[], double c[]);
ValveStatus valve_check_inputs(Valve *valve, const double inputs[]);
ValveStatus valve_rest(Valve *valve);
ValveStatus valve_settle(Valve *valve, double y[VALVE_COUPLED]);
void valve_propagate(Valve *valve, double step, double oil_before, double oil_after, const double from[], double to[]);
double valve_ambient(const Valve *valve);

#endif
