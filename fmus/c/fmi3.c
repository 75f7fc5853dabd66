/* FMI 3.0, co-simulation and model exchange, in terms of core.h. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core.h"
#include "fmi3Functions.h"

typedef struct {
    fmi3LogMessageCallback log;
    fmi3InstanceEnvironment environment;
    int tells; /* of events, category logEvents; errors are always told */
} Host;

static fmi3Status status(fmi3Instance c, int code) {
    if (code == 0) return fmi3OK;
    Host* h = ((Instance*)c)->host;
    if (h->log) h->log(h->environment, fmi3Error, "logStatusError", ((Instance*)c)->message);
    return fmi3Error;
}

/* The same, and what went well is told, with its time, to who asked for events. */
static fmi3Status event(fmi3Instance c, int code, const char* what) {
    Host* h = ((Instance*)c)->host;
    char text[120];
    if (code == 0 && h->tells && h->log) {
        snprintf(text, sizeof text, "%s at %.9g s", what, ((Instance*)c)->state->time);
        h->log(h->environment, fmi3OK, "logEvents", text);
    }
    return status(c, code);
}

static fmi3Status refuse(fmi3Instance c, const char* what) {
    snprintf(((Instance*)c)->message, sizeof((Instance*)c)->message, "%s", what);
    return status(c, -1);
}

const char* fmi3GetVersion(void) { return fmi3Version; }

static fmi3Instance instantiate(const char* wrong, const char* token, const char* resources, int exchange,
                                fmi3Boolean tells, fmi3InstanceEnvironment environment,
                                fmi3LogMessageCallback log) {
    char message[320] = "";
    Instance* c = NULL;
    Host* h = NULL;
    if (wrong) {
        snprintf(message, sizeof message, "%s", wrong);
    } else if (!token || strcmp(token, fmu.token) != 0) {
        snprintf(message, sizeof message,
                 "instantiation token does not match: binary and modelDescription.xml differ");
    } else if ((h = calloc(1, sizeof *h))) {
        c = core_new(resources ? resources : "", exchange, message, sizeof message);
    }
    if (!c) {
        free(h);
        if (log) log(environment, fmi3Error, "logStatusError", message);
        return NULL;
    }
    h->tells = tells;
    h->log = log;
    h->environment = environment;
    c->host = h;
    return c;
}

fmi3Instance fmi3InstantiateCoSimulation(
    fmi3String instanceName, fmi3String instantiationToken, fmi3String resourcePath, fmi3Boolean visible,
    fmi3Boolean loggingOn, fmi3Boolean eventModeUsed, fmi3Boolean earlyReturnAllowed,
    const fmi3ValueReference requiredIntermediateVariables[], size_t nRequiredIntermediateVariables,
    fmi3InstanceEnvironment environment, fmi3LogMessageCallback log,
    fmi3IntermediateUpdateCallback intermediateUpdate) {
    (void)instanceName, (void)visible, (void)earlyReturnAllowed;
    (void)requiredIntermediateVariables, (void)nRequiredIntermediateVariables, (void)intermediateUpdate;
    const char* wrong = eventModeUsed ? "event mode is not supported in co-simulation" : NULL;
    return instantiate(wrong, instantiationToken, resourcePath, 0, loggingOn, environment, log);
}

fmi3Instance fmi3InstantiateModelExchange(fmi3String instanceName, fmi3String instantiationToken,
                                          fmi3String resourcePath, fmi3Boolean visible,
                                          fmi3Boolean loggingOn, fmi3InstanceEnvironment environment,
                                          fmi3LogMessageCallback log) {
    (void)instanceName, (void)visible;
    const char* wrong = core_can_exchange() ? NULL : "only co-simulation is supported";
    return instantiate(wrong, instantiationToken, resourcePath, 1, loggingOn, environment, log);
}
fmi3Instance fmi3InstantiateScheduledExecution(fmi3String a, fmi3String b, fmi3String c, fmi3Boolean d,
                                               fmi3Boolean e, fmi3InstanceEnvironment environment,
                                               fmi3LogMessageCallback log, fmi3ClockUpdateCallback f,
                                               fmi3LockPreemptionCallback g, fmi3UnlockPreemptionCallback h) {
    (void)a, (void)b, (void)c, (void)d, (void)e, (void)f, (void)g, (void)h;
    if (log) log(environment, fmi3Error, "logStatusError", "only co-simulation is supported");
    return NULL;
}

void fmi3FreeInstance(fmi3Instance c) {
    if (!c) return;
    free(((Instance*)c)->host);
    core_free(c);
}

fmi3Status fmi3SetDebugLogging(fmi3Instance c, fmi3Boolean on, size_t n, const fmi3String categories[]) {
    Host* h = ((Instance*)c)->host;
    if (n == 0) h->tells = on;
    for (size_t i = 0; i < n; i++) {
        if (strcmp(categories[i], "logEvents") == 0) h->tells = on;
        else if (strcmp(categories[i], "logStatusError") != 0) return refuse(c, "there is no such log category");
    }
    return fmi3OK;
}

fmi3Status fmi3EnterInitializationMode(fmi3Instance c, fmi3Boolean toleranceDefined, fmi3Float64 tolerance,
                                       fmi3Float64 startTime, fmi3Boolean stopTimeDefined,
                                       fmi3Float64 stopTime) {
    (void)toleranceDefined, (void)tolerance;
    if (core_set_times(c, startTime, stopTimeDefined ? stopTime : HUGE_VAL)) return status(c, -1);
    return status(c, core_enter_initialization(c));
}
fmi3Status fmi3ExitInitializationMode(fmi3Instance c) {
    return event(c, core_exit_initialization(c), "initialized");
}
fmi3Status fmi3Terminate(fmi3Instance c) { return event(c, core_terminate(c), "terminated"); }
fmi3Status fmi3Reset(fmi3Instance c) {
    core_reset(c);
    return event(c, 0, "reset, now");
}

/* Get and set functions of one type, for variables of one kind, arrays element by element. */
#define VARIABLES(TYPE, KIND)                                                                            \
    fmi3Status fmi3Get##TYPE(fmi3Instance c, const fmi3ValueReference vr[], size_t n, fmi3##TYPE value[], \
                             size_t m) {                                                                 \
        double v;                                                                                        \
        if (core_size(vr, n) != m) return refuse(c, "fmi3Get" #TYPE ": " WRONG_SIZE);                    \
        for (; n > 0; n--, vr++)                                                                         \
            for (size_t i = 0, size = core_size(vr, 1); i < size; i++) {                                 \
                if (core_get(c, *vr, i, KIND, &v)) return status(c, -1);                                 \
                *value++ = (fmi3##TYPE)v;                                                                \
            }                                                                                            \
        return fmi3OK;                                                                                   \
    }                                                                                                    \
    fmi3Status fmi3Set##TYPE(fmi3Instance c, const fmi3ValueReference vr[], size_t n,                    \
                             const fmi3##TYPE value[], size_t m) {                                       \
        if (core_size(vr, n) != m) return refuse(c, "fmi3Set" #TYPE ": " WRONG_SIZE);                    \
        for (; n > 0; n--, vr++)                                                                         \
            for (size_t i = 0, size = core_size(vr, 1); i < size; i++) {                                 \
                const double v = (double)*value++;                                                       \
                if (core_set(c, *vr, i, KIND, &v)) return status(c, -1);                                 \
            }                                                                                            \
        return fmi3OK;                                                                                   \
    }
#define WRONG_SIZE "the number of values is not that of the variables"
VARIABLES(Float64, REAL)
VARIABLES(Int32, INTEGER)
VARIABLES(Boolean, BOOLEAN)
VARIABLES(Int64, ENUMERATION)

#define NO_VARIABLES(TYPE)                                                                              \
    fmi3Status fmi3Get##TYPE(fmi3Instance c, const fmi3ValueReference vr[], size_t n, fmi3##TYPE v[],   \
                             size_t m) {                                                                \
        (void)vr, (void)v, (void)m;                                                                     \
        return n == 0 ? fmi3OK : refuse(c, "fmi3Get" #TYPE ": the FMU has no variable of this type");   \
    }                                                                                                   \
    fmi3Status fmi3Set##TYPE(fmi3Instance c, const fmi3ValueReference vr[], size_t n,                   \
                             const fmi3##TYPE v[], size_t m) {                                          \
        (void)vr, (void)v, (void)m;                                                                     \
        return n == 0 ? fmi3OK : refuse(c, "fmi3Set" #TYPE ": the FMU has no variable of this type");   \
    }
NO_VARIABLES(Float32)
NO_VARIABLES(Int8)
NO_VARIABLES(UInt8)
NO_VARIABLES(Int16)
NO_VARIABLES(UInt16)
NO_VARIABLES(UInt32)
NO_VARIABLES(UInt64)
NO_VARIABLES(String)

fmi3Status fmi3GetBinary(fmi3Instance c, const fmi3ValueReference vr[], size_t n, size_t sizes[],
                         fmi3Binary v[], size_t m) {
    (void)vr, (void)sizes, (void)v, (void)m;
    return n == 0 ? fmi3OK : refuse(c, "fmi3GetBinary: the FMU has no variable of this type");
}
fmi3Status fmi3SetBinary(fmi3Instance c, const fmi3ValueReference vr[], size_t n, const size_t sizes[],
                         const fmi3Binary v[], size_t m) {
    (void)vr, (void)sizes, (void)v, (void)m;
    return n == 0 ? fmi3OK : refuse(c, "fmi3SetBinary: the FMU has no variable of this type");
}

fmi3Status fmi3GetFMUState(fmi3Instance c, fmi3FMUState* state) {
    if (!*state && !(*state = malloc(core_saved_size(c)))) return refuse(c, "out of memory");
    core_save(c, *state);
    return fmi3OK;
}
fmi3Status fmi3SetFMUState(fmi3Instance c, fmi3FMUState state) {
    if (!state) return refuse(c, "no state was saved");
    return event(c, core_restore(c, state, core_saved_size(c)), "restored a state, now");
}
fmi3Status fmi3FreeFMUState(fmi3Instance c, fmi3FMUState* state) {
    (void)c;
    if (state) {
        free(*state);
        *state = NULL;
    }
    return fmi3OK;
}
fmi3Status fmi3SerializedFMUStateSize(fmi3Instance c, fmi3FMUState state, size_t* size) {
    (void)state;
    *size = core_saved_size(c);
    return fmi3OK;
}
fmi3Status fmi3SerializeFMUState(fmi3Instance c, fmi3FMUState state, fmi3Byte bytes[], size_t size) {
    if (!state || size < core_saved_size(c)) return refuse(c, "buffer too small for the saved state");
    memcpy(bytes, state, core_saved_size(c));
    return fmi3OK;
}
fmi3Status fmi3DeserializeFMUState(fmi3Instance c, const fmi3Byte bytes[], size_t size, fmi3FMUState* state) {
    if (core_check_saved(c, (const char*)bytes, size)) return status(c, -1);
    if (!*state && !(*state = malloc(size))) return refuse(c, "out of memory");
    memcpy(*state, bytes, size);
    return fmi3OK;
}

fmi3Status fmi3DoStep(fmi3Instance c, fmi3Float64 time, fmi3Float64 h, fmi3Boolean noSetFMUStatePrior,
                      fmi3Boolean* eventHandlingNeeded, fmi3Boolean* terminateSimulation,
                      fmi3Boolean* earlyReturn, fmi3Float64* lastSuccessfulTime) {
    (void)noSetFMUStatePrior;
    int code = core_step(c, time, h);
    if (eventHandlingNeeded) *eventHandlingNeeded = fmi3False;
    if (terminateSimulation) *terminateSimulation = fmi3False;
    if (earlyReturn) *earlyReturn = fmi3False;
    if (lastSuccessfulTime) *lastSuccessfulTime = ((Instance*)c)->state->time;
    return status(c, code);
}

fmi3Status fmi3EnterEventMode(fmi3Instance c) { return event(c, core_enter_event(c), "event"); }
fmi3Status fmi3EnterContinuousTimeMode(fmi3Instance c) { return status(c, core_enter_time(c)); }
fmi3Status fmi3EvaluateDiscreteStates(fmi3Instance c) { return status(c, core_evaluate(c)); }
fmi3Status fmi3UpdateDiscreteStates(fmi3Instance c, fmi3Boolean* discreteStatesNeedUpdate,
                                    fmi3Boolean* terminateSimulation,
                                    fmi3Boolean* nominalsOfContinuousStatesChanged,
                                    fmi3Boolean* valuesOfContinuousStatesChanged,
                                    fmi3Boolean* nextEventTimeDefined, fmi3Float64* nextEventTime) {
    int moved;
    double next;
    if (core_update(c, &moved, &next)) return status(c, -1);
    *discreteStatesNeedUpdate = fmi3False;
    *terminateSimulation = fmi3False;
    *nominalsOfContinuousStatesChanged = fmi3False;
    *valuesOfContinuousStatesChanged = moved != 0;
    *nextEventTimeDefined = isfinite(next) != 0;
    *nextEventTime = isfinite(next) ? next : 0;
    return fmi3OK;
}
fmi3Status fmi3CompletedIntegratorStep(fmi3Instance c, fmi3Boolean noSetFMUStatePrior,
                                       fmi3Boolean* enterEventMode, fmi3Boolean* terminateSimulation) {
    (void)noSetFMUStatePrior;
    *enterEventMode = *terminateSimulation = fmi3False;
    return status(c, core_completed_step(c));
}
fmi3Status fmi3SetTime(fmi3Instance c, fmi3Float64 time) { return status(c, core_set_time(c, time)); }
fmi3Status fmi3SetContinuousStates(fmi3Instance c, const fmi3Float64 x[], size_t n) {
    return status(c, core_set_states(c, x, n));
}
fmi3Status fmi3GetContinuousStates(fmi3Instance c, fmi3Float64 x[], size_t n) {
    return status(c, core_get_states(c, x, n));
}
fmi3Status fmi3GetContinuousStateDerivatives(fmi3Instance c, fmi3Float64 derivatives[], size_t n) {
    return status(c, core_get_derivatives(c, derivatives, n));
}
fmi3Status fmi3GetEventIndicators(fmi3Instance c, fmi3Float64 z[], size_t n) {
    return status(c, core_get_crossings(c, z, n));
}
fmi3Status fmi3GetNominalsOfContinuousStates(fmi3Instance c, fmi3Float64 x[], size_t n) {
    return status(c, core_get_nominals(c, x, n));
}
fmi3Status fmi3GetNumberOfContinuousStates(fmi3Instance c, size_t* n) {
    (void)c;
    *n = fmu.models[0]->n_continuous;
    return fmi3OK;
}
fmi3Status fmi3GetNumberOfEventIndicators(fmi3Instance c, size_t* n) {
    (void)c;
    *n = fmu.models[0]->n_crossings;
    return fmi3OK;
}

fmi3Status fmi3GetDirectionalDerivative(fmi3Instance c, const fmi3ValueReference unknown[], size_t nUnknown,
                                        const fmi3ValueReference known[], size_t nKnown,
                                        const fmi3Float64 seed[], size_t nSeed, fmi3Float64 result[],
                                        size_t nResult) {
    if (nSeed != core_size(known, nKnown) || nResult != core_size(unknown, nUnknown))
        return refuse(c, "fmi3GetDirectionalDerivative: " WRONG_SIZE);
    return status(c, core_derivative(c, unknown, nUnknown, known, nKnown, seed, result));
}

/* Everything below belongs to capabilities that modelDescription.xml does not claim. */
#define UNSUPPORTED(NAME, ...)                                 \
    fmi3Status NAME(fmi3Instance c, ##__VA_ARGS__) {           \
        return refuse(c, #NAME " is not supported by this FMU"); \
    }
#pragma GCC diagnostic ignored "-Wunused-parameter"
typedef const fmi3ValueReference Vr[];
UNSUPPORTED(fmi3GetClock, Vr vr, size_t n, fmi3Clock v[])
UNSUPPORTED(fmi3SetClock, Vr vr, size_t n, const fmi3Clock v[])
UNSUPPORTED(fmi3GetNumberOfVariableDependencies, fmi3ValueReference vr, size_t* n)
UNSUPPORTED(fmi3GetVariableDependencies, fmi3ValueReference vr, size_t a[], fmi3ValueReference b[], size_t d[],
            fmi3DependencyKind k[], size_t n)
UNSUPPORTED(fmi3GetAdjointDerivative, Vr u, size_t nu, Vr k, size_t nk, const fmi3Float64 seed[], size_t ns,
            fmi3Float64 d[], size_t nd)
UNSUPPORTED(fmi3EnterConfigurationMode)
UNSUPPORTED(fmi3ExitConfigurationMode)
UNSUPPORTED(fmi3EnterStepMode)
UNSUPPORTED(fmi3GetIntervalDecimal, Vr vr, size_t n, fmi3Float64 v[], fmi3IntervalQualifier q[])
UNSUPPORTED(fmi3GetIntervalFraction, Vr vr, size_t n, fmi3UInt64 a[], fmi3UInt64 b[], fmi3IntervalQualifier q[])
UNSUPPORTED(fmi3GetShiftDecimal, Vr vr, size_t n, fmi3Float64 v[])
UNSUPPORTED(fmi3GetShiftFraction, Vr vr, size_t n, fmi3UInt64 a[], fmi3UInt64 b[])
UNSUPPORTED(fmi3SetIntervalDecimal, Vr vr, size_t n, const fmi3Float64 v[])
UNSUPPORTED(fmi3SetIntervalFraction, Vr vr, size_t n, const fmi3UInt64 a[], const fmi3UInt64 b[])
UNSUPPORTED(fmi3SetShiftDecimal, Vr vr, size_t n, const fmi3Float64 v[])
UNSUPPORTED(fmi3SetShiftFraction, Vr vr, size_t n, const fmi3UInt64 a[], const fmi3UInt64 b[])
UNSUPPORTED(fmi3GetOutputDerivatives, Vr vr, size_t n, const fmi3Int32 order[], fmi3Float64 v[], size_t m)
UNSUPPORTED(fmi3ActivateModelPartition, fmi3ValueReference clock, fmi3Float64 t)
