/* An importer of this repository's own FMUs without Python: benchmarks/fmu.py compiles and runs it.
 *
 *   importer BINARY VERSION TOKEN fly  INPUTS.csv OUTPUTS.csv TOLERANCE REF...   co-simulation, inputs straight between rows
 *   importer BINARY VERSION TOKEN hold INPUTS.csv OUTPUTS.csv TOLERANCE REF...   co-simulation, inputs held in each step
 *   importer BINARY VERSION TOKEN exchange INPUTS.csv OUTPUTS.csv SUBSTEPS REF... model exchange by Runge-Kutta's method
 *   importer BINARY VERSION TOKEN many COUNT                                      instances made, flown, freed
 *   importer BINARY VERSION TOKEN fuzz SEED COUNT REF...                          random calls with random arguments
 *
 * INPUTS.csv: first row value references (the first of them 0: time), then numbers. Values at a time stand twice where
 * the inputs jump. At the end the libraries in memory are searched for any of Python.
 */
#include <dlfcn.h>
#include <malloc.h>
#include <math.h>
#include <stdarg.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "fmi2Functions.h"
#include "fmi3Functions.h"

#define MOST 400

static void *library;
static int version, co_simulation = 1;
static void *instance;
static const char *token;
static unsigned input_refs[MOST], output_refs[MOST];
static int input_count, output_count, messages;
static char last_message[512];
static const double *row_before, *row_after; /* of the table, around the present step */

static void *function(const char *name)
{
    char whole[100];
    void *found;
    (void)snprintf(whole, sizeof whole, "fmi%d%s", version, name);
    found = dlsym(library, whole);
    if (found == NULL) {
        (void)fprintf(stderr, "no %s: %s\n", whole, dlerror());
        exit(2);
    }
    return found;
}

#define CALL2(name, ...) (((fmi2##name##TYPE *)function(#name))(__VA_ARGS__))
#define CALL3(name, ...) (((fmi3##name##TYPE *)function(#name))(__VA_ARGS__))

static void hear2(void *environment, fmi2String name, fmi2Status status, fmi2String category, fmi2String format, ...)
{
    va_list arguments;
    (void)environment; (void)name; (void)status; (void)category;
    va_start(arguments, format);
    (void)vsnprintf(last_message, sizeof last_message, format, arguments);
    va_end(arguments);
    messages++;
}

static void hear3(void *environment, fmi3Status status, fmi3String category, fmi3String message)
{
    (void)environment; (void)status; (void)category;
    (void)snprintf(last_message, sizeof last_message, "%s", message);
    messages++;
}

static int set(const double values[])
{
    return (version == 2) ? (int)CALL2(SetReal, instance, input_refs, (size_t)input_count, values)
                          : (int)CALL3(SetFloat64, instance, input_refs, (size_t)input_count, values, (size_t)input_count);
}

static int get(double values[])
{
    return (version == 2) ? (int)CALL2(GetReal, instance, output_refs, (size_t)output_count, values)
                          : (int)CALL3(GetFloat64, instance, output_refs, (size_t)output_count, values, (size_t)output_count);
}

static void check(int status, const char *what)
{
    if (status != 0) {
        (void)fprintf(stderr, "%s: status %d, %s\n", what, status, last_message);
        exit(1);
    }
}

static void inputs_now(double time, double values[])
{
    const double width = row_after[0] - row_before[0], share = (width > 0.0) ? (time - row_before[0]) / width : 0.0;
    int k;
    for (k = 0; k < input_count; k++) {
        values[k] = row_before[k + 1] + share * (row_after[k + 1] - row_before[k + 1]);
    }
}

static void update3(fmi3InstanceEnvironment environment, fmi3Float64 time, fmi3Boolean may_set, fmi3Boolean may_get,
                    fmi3Boolean done, fmi3Boolean can_stop, fmi3Boolean *stop, fmi3Float64 *stop_time)
{
    double values[MOST];
    (void)environment; (void)may_get; (void)done; (void)can_stop; (void)stop; (void)stop_time;
    if (may_set) {
        inputs_now(time, values);
        (void)set(values);
    }
}

/* Where an FMU that holds others finds them: FMU_RESOURCES of the environment. */
static const char *resources(void)
{
    const char *told = getenv("FMU_RESOURCES");
    return (told != NULL) ? told : "";
}

static void instantiate(int straight)
{
    static fmi2CallbackFunctions functions;
    functions.logger = hear2;
    functions.allocateMemory = calloc;
    functions.freeMemory = free;
    if (version == 2) {
        instance = CALL2(Instantiate, "valve", co_simulation ? fmi2CoSimulation : fmi2ModelExchange, token, resources(), &functions,
                         fmi2False, fmi2False);
    } else if (co_simulation) {
        instance = CALL3(InstantiateCoSimulation, "valve", token, resources(), false, false, false, false,
                         straight ? input_refs : NULL, straight ? (size_t)input_count : 0, NULL, hear3,
                         straight ? update3 : NULL);
    } else {
        instance = CALL3(InstantiateModelExchange, "valve", token, resources(), false, false, NULL, hear3);
    }
    if (instance == NULL) {
        (void)fprintf(stderr, "no instance: %s\n", last_message);
        exit(1);
    }
}

static void release(void)
{
    if (version == 2) {
        CALL2(FreeInstance, instance);
    } else {
        CALL3(FreeInstance, instance);
    }
    instance = NULL;
}

static void start(double tolerance)
{
    if (version == 2) {
        check(CALL2(SetupExperiment, instance, tolerance > 0.0, tolerance, 0.0, fmi2False, 0.0), "SetupExperiment");
        check(CALL2(EnterInitializationMode, instance), "EnterInitializationMode");
    } else {
        check(CALL3(EnterInitializationMode, instance, tolerance > 0.0, tolerance, 0.0, false, 0.0),
              "EnterInitializationMode");
    }
}

static void run(void)
{
    if (version == 2) {
        check(CALL2(ExitInitializationMode, instance), "ExitInitializationMode");
    } else {
        check(CALL3(ExitInitializationMode, instance), "ExitInitializationMode");
    }
}

static void step(double time, double size)
{
    if (version == 2) {
        check(CALL2(DoStep, instance, time, size, fmi2True), "DoStep");
    } else {
        bool event, stop, early;
        double reached;
        check(CALL3(DoStep, instance, time, size, true, &event, &stop, &early, &reached), "DoStep");
    }
}

static double *read_table(const char *path, int *rows)
{
    FILE *file = fopen(path, "r");
    char *line = malloc(1 << 16);
    double *table = NULL;
    size_t room = 0, used = 0;
    int first = 1;
    *rows = 0;
    if ((file == NULL) || (line == NULL)) {
        exit(2);
    }
    while (fgets(line, 1 << 16, file) != NULL) {
        char *word = strtok(line, ",");
        int column = 0;
        while (word != NULL) {
            if (first) {
                if (column > 0) {
                    input_refs[input_count++] = (unsigned)strtoul(word, NULL, 10);
                }
            } else {
                if (used == room) {
                    room = 2 * room + 1024;
                    table = realloc(table, room * sizeof *table);
                }
                table[used++] = strtod(word, NULL);
            }
            column++;
            word = strtok(NULL, ",");
        }
        *rows += first ? 0 : 1;
        first = 0;
    }
    (void)fclose(file);
    free(line);
    return table;
}

static void write_row(FILE *file, double time)
{
    double values[MOST];
    int k;
    check(get(values), "Get");
    (void)fprintf(file, "%.17g", time);
    for (k = 0; k < output_count; k++) {
        (void)fprintf(file, ",%.17g", values[k]);
    }
    (void)fputc('\n', file);
}

static double seconds(void)
{
    struct timespec now;
    (void)clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &now);
    return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}

static void fly(const char *inputs, const char *outputs, double tolerance, int straight)
{
    int rows, k, j;
    double *table = read_table(inputs, &rows), spent = 0.0;
    const int width = input_count + 1;
    FILE *file = fopen(outputs, "w");
    instantiate(straight);
    start(tolerance);
    check(set(&table[1]), "Set");
    run();
    write_row(file, table[0]);
    for (k = 0; k + 1 < rows; k++) {
        double begun;
        row_before = &table[k * width];
        row_after = &table[(k + 1) * width];
        if (row_after[0] <= row_before[0]) {
            continue; /* a jump */
        }
        begun = seconds();
        check(set(&row_before[1]), "Set");
        if (straight && (version == 2)) {
            double slopes[MOST];
            int orders[MOST];
            for (j = 0; j < input_count; j++) {
                orders[j] = 1;
                slopes[j] = (row_after[j + 1] - row_before[j + 1]) / (row_after[0] - row_before[0]);
            }
            check(CALL2(SetRealInputDerivatives, instance, input_refs, (size_t)input_count, orders, slopes), "SetDerivatives");
        }
        step(row_before[0], row_after[0] - row_before[0]);
        spent += seconds() - begun;
        write_row(file, row_after[0]);
    }
    (void)fclose(file);
    (void)printf("processor seconds in steps: %.6f\n", spent);
    release();
    free(table);
}

static void rates(double time, const double x[], double out[], int n)
{
    double values[MOST];
    inputs_now(time, values);
    if (version == 2) {
        check(CALL2(SetTime, instance, time), "SetTime");
        check(set(values), "Set");
        check(CALL2(SetContinuousStates, instance, x, (size_t)n), "SetContinuousStates");
        check(CALL2(GetDerivatives, instance, out, (size_t)n), "GetDerivatives");
    } else {
        check(CALL3(SetTime, instance, time), "SetTime");
        check(set(values), "Set");
        check(CALL3(SetContinuousStates, instance, x, (size_t)n), "SetContinuousStates");
        check(CALL3(GetContinuousStateDerivatives, instance, out, (size_t)n), "GetDerivatives");
    }
}

static void exchange(const char *inputs, const char *outputs, int substeps, int n)
{
    int rows, k, j, i;
    double *table = read_table(inputs, &rows), x[MOST], f[4][MOST], at[MOST];
    const int width = input_count + 1;
    FILE *file = fopen(outputs, "w");
    instantiate(0);
    start(0.0);
    check(set(&table[1]), "Set");
    run();
    for (k = 0; k + 1 < rows; k++) {
        const double h = (table[(k + 1) * width] - table[k * width]) / substeps;
        row_before = &table[k * width];
        row_after = &table[(k + 1) * width];
        if ((k == 0) || (h <= 0.0)) { /* an event: the start, or a jump of the inputs */
            if (k > 0) {
                check((version == 2) ? (int)CALL2(EnterEventMode, instance) : (int)CALL3(EnterEventMode, instance), "Event");
                check(set(&row_after[1]), "Set");
            }
            if (version == 2) {
                fmi2EventInfo info;
                check(CALL2(NewDiscreteStates, instance, &info), "NewDiscreteStates");
                check(CALL2(EnterContinuousTimeMode, instance), "EnterContinuousTimeMode");
            } else {
                bool a, b, c, d, e;
                double t;
                check(CALL3(UpdateDiscreteStates, instance, &a, &b, &c, &d, &e, &t), "UpdateDiscreteStates");
                check(CALL3(EnterContinuousTimeMode, instance), "EnterContinuousTimeMode");
            }
            check((version == 2) ? (int)CALL2(GetContinuousStates, instance, x, (size_t)n)
                                 : (int)CALL3(GetContinuousStates, instance, x, (size_t)n), "GetContinuousStates");
            if (k == 0) {
                write_row(file, table[0]);
            }
            if (h <= 0.0) {
                continue;
            }
        }
        for (j = 0; j < substeps; j++) {
            const double t = row_before[0] + h * j;
            rates(t, x, f[0], n);
            for (i = 0; i < n; i++) at[i] = x[i] + 0.5 * h * f[0][i];
            rates(t + 0.5 * h, at, f[1], n);
            for (i = 0; i < n; i++) at[i] = x[i] + 0.5 * h * f[1][i];
            rates(t + 0.5 * h, at, f[2], n);
            for (i = 0; i < n; i++) at[i] = x[i] + h * f[2][i];
            rates(t + h, at, f[3], n);
            for (i = 0; i < n; i++) x[i] += h / 6.0 * (f[0][i] + 2.0 * f[1][i] + 2.0 * f[2][i] + f[3][i]);
        }
        rates(row_after[0], x, f[0], n);
        write_row(file, row_after[0]);
    }
    (void)fclose(file);
    release();
    free(table);
}

static void many(int count)
{
    size_t before = 0, after = 0;
    int k;
    for (k = 0; k < count; k++) {
        void *state = NULL;
        instantiate(0);
        start(0.0);
        run();
        step(0.0, 1e-3);
        if (version == 2) {
            check(CALL2(GetFMUstate, instance, &state), "GetFMUstate");
            check(CALL2(FreeFMUstate, instance, &state), "FreeFMUstate");
        } else {
            check(CALL3(GetFMUState, instance, &state), "GetFMUState");
            check(CALL3(FreeFMUState, instance, &state), "FreeFMUState");
        }
        release();
        if (k == 9) {
            before = mallinfo2().uordblks;
        }
    }
    after = mallinfo2().uordblks;
    (void)printf("%d instances: %ld bytes more in use after the last than after the tenth\n", count, (long)after - (long)before);
}

static double any_number(void)
{
    static const double odd[] = {0.0, -0.0, 1.0, -1.0, 1e-3, 1e300, -1e300, 5e-324, 0.02, 2e7};
    switch (rand() % 4) {
    case 0: return NAN;
    case 1: return (rand() % 2) ? INFINITY : -INFINITY;
    case 2: return odd[rand() % 10];
    default: return ((double)rand() / RAND_MAX - 0.5) * pow(10.0, rand() % 16 - 8);
    }
}

static unsigned any_reference(void)
{
    static const unsigned blocks[] = {0, 1000, 2000, 3000, 4000, 5000, 6000, 4294967000u};
    return blocks[rand() % 8] + (unsigned)(rand() % ((rand() % 10) ? 30 : 1200));
}

/* Calls in any order with any arguments: whatever comes, a status and no crash. */
static void fuzz(unsigned seed, int count)
{
    int k, good = 0;
    srand(seed);
    co_simulation = rand() % 2;
    instantiate(0);
    for (k = 0; k < count; k++) {
        unsigned refs[3] = {any_reference(), any_reference(), any_reference()};
        double values[3] = {any_number(), any_number(), any_number()}, more[MOST] = {0.0};
        int orders[3] = {rand() % 6 - 1, 1, 1}, which = rand() % 22, status = 0;
        size_t n = (size_t)(rand() % 4), few = (size_t)(rand() % 40);
        bool flags[5];
        void *state = NULL;
        fmi2EventInfo info;
        fmi2Boolean b2;
        unsigned char bytes[64] = {0};
        for (int i = 0; i < MOST; i++) {
            more[i] = (rand() % 20) ? 1e-4 * (double)(rand() % 100) : any_number();
        }
        if (version == 2) {
            switch (which) {
            case 0: status = CALL2(SetupExperiment, instance, rand() % 2, values[0], values[1], rand() % 2, values[2]); break;
            case 1: status = CALL2(EnterInitializationMode, instance); break;
            case 2: status = CALL2(ExitInitializationMode, instance); break;
            case 3: case 4: status = CALL2(SetReal, instance, refs, n, values); break;
            case 5: case 6: status = CALL2(GetReal, instance, refs, n, values); break;
            case 7: status = CALL2(DoStep, instance, (rand() % 2) ? 0.0 : values[0], (fabs(values[1]) < 1e-3 || rand() % 9 == 0) ? fmin(values[1], 1e-3) : 1e-5, 1); break;
            case 8: status = CALL2(EnterEventMode, instance); break;
            case 9: status = CALL2(NewDiscreteStates, instance, &info); break;
            case 10: status = CALL2(EnterContinuousTimeMode, instance); break;
            case 11: status = CALL2(SetContinuousStates, instance, more, few); break;
            case 12: status = CALL2(GetDerivatives, instance, more, few); break;
            case 13: status = CALL2(GetContinuousStates, instance, more, few); break;
            case 14: status = CALL2(SetTime, instance, values[0]); break;
            case 15: status = CALL2(CompletedIntegratorStep, instance, 1, &b2, &b2); break;
            case 16: status = CALL2(GetDirectionalDerivative, instance, refs, n, refs, n, values, more); break;
            case 17: status = CALL2(SetRealInputDerivatives, instance, refs, n, orders, values); break;
            case 18: status = CALL2(GetFMUstate, instance, &state); status |= CALL2(SetFMUstate, instance, state); CALL2(FreeFMUstate, instance, &state); break;
            case 19: status = CALL2(DeSerializeFMUstate, instance, (char *)bytes, few, &state); CALL2(FreeFMUstate, instance, &state); break;
            case 20: status = (rand() % 8) ? (int)CALL2(GetRealOutputDerivatives, instance, refs, n, orders, values) : (int)CALL2(Terminate, instance); break;
            default: status = (rand() % 8) ? (int)CALL2(GetNominalsOfContinuousStates, instance, more, few) : (int)CALL2(Reset, instance); break;
            }
        } else {
            switch (which) {
            case 0: status = CALL3(EnterInitializationMode, instance, rand() % 2, values[0], values[1], rand() % 2, values[2]); break;
            case 1: status = CALL3(EnterInitializationMode, instance, false, 0.0, 0.0, false, 0.0); break;
            case 2: status = CALL3(ExitInitializationMode, instance); break;
            case 3: case 4: status = CALL3(SetFloat64, instance, refs, n, values, n); break;
            case 5: case 6: status = CALL3(GetFloat64, instance, refs, n, values, (rand() % 9) ? n : few); break;
            case 7: status = CALL3(DoStep, instance, (rand() % 2) ? 0.0 : values[0], (fabs(values[1]) < 1e-3 || rand() % 9 == 0) ? fmin(values[1], 1e-3) : 1e-5, true, &flags[0], &flags[1], &flags[2], &values[2]); break;
            case 8: status = CALL3(EnterEventMode, instance); break;
            case 9: status = CALL3(UpdateDiscreteStates, instance, &flags[0], &flags[1], &flags[2], &flags[3], &flags[4], &values[0]); break;
            case 10: status = CALL3(EnterContinuousTimeMode, instance); break;
            case 11: status = CALL3(SetContinuousStates, instance, more, few); break;
            case 12: status = CALL3(GetContinuousStateDerivatives, instance, more, few); break;
            case 13: status = CALL3(GetContinuousStates, instance, more, few); break;
            case 14: status = CALL3(SetTime, instance, values[0]); break;
            case 15: status = CALL3(CompletedIntegratorStep, instance, true, &flags[0], &flags[1]); break;
            case 16: status = CALL3(GetDirectionalDerivative, instance, refs, n, refs, n, values, n, more, n); break;
            case 17: status = CALL3(GetAdjointDerivative, instance, refs, n, refs, n, values, n, more, n); break;
            case 18: status = CALL3(GetFMUState, instance, &state); status |= CALL3(SetFMUState, instance, state); CALL3(FreeFMUState, instance, &state); break;
            case 19: status = CALL3(DeserializeFMUState, instance, bytes, few, &state); CALL3(FreeFMUState, instance, &state); break;
            case 20: status = (rand() % 8) ? (int)CALL3(GetOutputDerivatives, instance, refs, n, orders, values, n) : (int)CALL3(Terminate, instance); break;
            default: status = (rand() % 8) ? (int)CALL3(GetString, instance, refs, n, NULL, n) : (int)CALL3(Reset, instance); break;
            }
        }
        good += (status == 0);
    }
    release();
    (void)printf("%d calls: %d well, %d refused with %d messages\n", count, good, count - good, messages);
}

static int mapped_python(void)
{
    FILE *maps = fopen("/proc/self/maps", "r");
    char line[1000];
    int found = 0;
    while ((maps != NULL) && (fgets(line, sizeof line, maps) != NULL)) {
        found += (strstr(line, "python") != NULL);
    }
    if (maps != NULL) {
        (void)fclose(maps);
    }
    return found;
}

int main(int count, char *words[])
{
    int k;
    if (count < 6) {
        return 2;
    }
    library = dlopen(words[1], RTLD_NOW | RTLD_LOCAL);
    if (library == NULL) {
        (void)fprintf(stderr, "%s\n", dlerror());
        return 2;
    }
    version = atoi(words[2]);
    token = words[3];
    for (k = 8; k < count; k++) {
        output_refs[output_count++] = (unsigned)strtoul(words[k], NULL, 10);
    }
    if (strcmp(words[4], "fly") == 0) {
        fly(words[5], words[6], strtod(words[7], NULL), 1);
    } else if (strcmp(words[4], "hold") == 0) {
        fly(words[5], words[6], strtod(words[7], NULL), 0);
    } else if (strcmp(words[4], "exchange") == 0) {
        int states = 0;
        for (k = 0; k < output_count; k++) {
            states += (output_refs[k] >= 3000u) && (output_refs[k] < 4000u);
        }
        co_simulation = 0;
        exchange(words[5], words[6], atoi(words[7]), states);
    } else if (strcmp(words[4], "many") == 0) {
        many(atoi(words[5]));
    } else {
        fuzz((unsigned)atoi(words[5]), atoi(words[6]));
    }
    (void)printf("lines of this process's memory map that name python: %d\n", mapped_python());
    return 0;
}
