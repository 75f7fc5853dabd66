/* FMI 2.0, co-simulation and model exchange, in terms of core.h. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core.h"
#include "fmi2Functions.h"

typedef struct {
    fmi2CallbackLogger logger;
    fmi2ComponentEnvironment environment;
    int tells; /* of events, category logEvents; errors are always told */
    char name[1]; /* grows with the instance name */
} Host;

static Host* host(fmi2Component c) { return ((Instance*)c)->host; }

/* The logger takes a printf format. Many importers never expand it, so the text goes in as the
 * format itself, with its percent signs doubled. */
static void log_text(fmi2CallbackLogger logger, fmi2ComponentEnvironment environment, const char* name,
                     fmi2Status as, const char* message) {
    char format[700];
    size_t n = 0;
    if (!logger) return;
    for (const char* p = message; *p && n + 2 < sizeof format; p++) {
        if (*p == '%') format[n++] = '%';
        format[n++] = *p;
    }
    format[n] = 0;
    logger(environment, name, as, as == fmi2OK ? "logEvents" : "logStatusError", format);
}

static fmi2Status status(fmi2Component c, int code) {
    if (code == 0) return fmi2OK;
    Host* h = host(c);
    log_text(h->logger, h->environment, h->name, fmi2Error, ((Instance*)c)->message);
    return fmi2Error;
}

/* The same, and what went well is told, with its time, to who asked for events. */
static fmi2Status event(fmi2Component c, int code, const char* what) {
    Host* h = host(c);
    char text[120];
    if (code == 0 && h->tells) {
        snprintf(text, sizeof text, "%s at %.9g s", what, ((Instance*)c)->state->time);
        log_text(h->logger, h->environment, h->name, fmi2OK, text);
    }
    return status(c, code);
}

static fmi2Status refuse(fmi2Component c, const char* what) {
    snprintf(((Instance*)c)->message, sizeof((Instance*)c)->message, "%s", what);
    return status(c, -1);
}

/* "file:///a%20b/resources" -> "/a b/resources"; a path stays as it is. */
static void path_of_uri(const char* uri, char* path, size_t size) {
    const char* p = uri;
    if (strncmp(p, "file://", 7) == 0) {
        p += 7;
        if (strncmp(p, "localhost/", 10) == 0) p += 9;
#ifdef _WIN32
        if (p[0] == '/' && p[1] && p[2] == ':') p++;
#endif
    } else if (strncmp(p, "file:", 5) == 0) {
        p += 5;
    } else {
        snprintf(path, size, "%s", uri);
        return;
    }
    size_t n = 0;
    for (; *p && n + 1 < size; p++, n++) {
        unsigned byte;
        if (*p == '%' && sscanf(p + 1, "%2x", &byte) == 1) {
            path[n] = (char)byte;
            p += 2;
        } else {
            path[n] = *p;
        }
    }
    path[n] = 0;
}

const char* fmi2GetTypesPlatform(void) { return fmi2TypesPlatform; }
const char* fmi2GetVersion(void) { return fmi2Version; }

fmi2Component fmi2Instantiate(fmi2String instanceName, fmi2Type fmuType, fmi2String fmuGUID,
                              fmi2String fmuResourceLocation, const fmi2CallbackFunctions* functions,
                              fmi2Boolean visible, fmi2Boolean loggingOn) {
    (void)visible;
    fmi2CallbackLogger logger = functions ? functions->logger : NULL;
    fmi2ComponentEnvironment environment = functions ? functions->componentEnvironment : NULL;
    const char* name = instanceName ? instanceName : "";
    char message[320] = "", path[4096] = "";
    Instance* c = NULL;
    Host* h = NULL;
    if (fmuType != fmi2CoSimulation && !core_can_exchange()) {
        snprintf(message, sizeof message, "only co-simulation is supported");
    } else if (!fmuGUID || strcmp(fmuGUID, fmu.token) != 0) {
        snprintf(message, sizeof message, "GUID does not match: binary and modelDescription.xml differ");
    } else if ((h = calloc(1, sizeof *h + strlen(name)))) {
        path_of_uri(fmuResourceLocation ? fmuResourceLocation : "", path, sizeof path);
        c = core_new(path, fmuType != fmi2CoSimulation, message, sizeof message);
    }
    if (!c) {
        free(h);
        log_text(logger, environment, name, fmi2Error, message);
        return NULL;
    }
    strcpy(h->name, name);
    h->tells = loggingOn != fmi2False;
    h->logger = logger;
    h->environment = environment;
    c->host = h;
    return c;
}

void fmi2FreeInstance(fmi2Component c) {
    if (!c) return;
    free(host(c));
    core_free(c);
}

fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean on, size_t n, const fmi2String categories[]) {
    if (n == 0) host(c)->tells = on != fmi2False;
    for (size_t i = 0; i < n; i++) {
        if (strcmp(categories[i], "logEvents") == 0) host(c)->tells = on != fmi2False;
        else if (strcmp(categories[i], "logStatusError") != 0) return refuse(c, "there is no such log category");
    }
    return fmi2OK;
}

fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean toleranceDefined, fmi2Real tolerance,
                               fmi2Real startTime, fmi2Boolean stopTimeDefined, fmi2Real stopTime) {
    (void)toleranceDefined, (void)tolerance;
    return status(c, core_set_times(c, startTime, stopTimeDefined ? stopTime : HUGE_VAL));
}

fmi2Status fmi2EnterInitializationMode(fmi2Component c) { return status(c, core_enter_initialization(c)); }
fmi2Status fmi2ExitInitializationMode(fmi2Component c) {
    return event(c, core_exit_initialization(c), "initialized");
}
fmi2Status fmi2Terminate(fmi2Component c) { return event(c, core_terminate(c), "terminated"); }
fmi2Status fmi2Reset(fmi2Component c) {
    core_reset(c);
    return event(c, 0, "reset, now");
}

/* Get and set functions of one type, for variables of some kinds. */
#define VARIABLES(TYPE, KINDS)                                                                              \
    fmi2Status fmi2Get##TYPE(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2##TYPE value[]) { \
        double v;                                                                                           \
        for (size_t i = 0; i < n; i++) {                                                                    \
            if (core_get(c, vr[i], 0, KINDS, &v)) return status(c, -1);                                        \
            value[i] = (fmi2##TYPE)v;                                                                       \
        }                                                                                                   \
        return fmi2OK;                                                                                      \
    }                                                                                                       \
    fmi2Status fmi2Set##TYPE(fmi2Component c, const fmi2ValueReference vr[], size_t n,                      \
                             const fmi2##TYPE value[]) {                                                    \
        for (size_t i = 0; i < n; i++) {                                                                    \
            const double v = (KINDS) == BOOLEAN ? value[i] != 0 : (double)value[i];                         \
            if (core_set(c, vr[i], 0, KINDS, &v)) return status(c, -1);                                         \
        }                                                                                                   \
        return fmi2OK;                                                                                      \
    }
VARIABLES(Real, REAL)
VARIABLES(Integer, INTEGER | ENUMERATION)
VARIABLES(Boolean, BOOLEAN)

#define NO_VARIABLES(NAME, TYPE)                                                                       \
    fmi2Status NAME(fmi2Component c, const fmi2ValueReference vr[], size_t n, TYPE value[]) {          \
        (void)vr, (void)value;                                                                         \
        return n == 0 ? fmi2OK : refuse(c, #NAME ": the FMU has no variable of this type");            \
    }
NO_VARIABLES(fmi2GetString, fmi2String)
NO_VARIABLES(fmi2SetString, const fmi2String)

fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate* state) {
    if (!*state && !(*state = malloc(core_saved_size(c)))) return refuse(c, "out of memory");
    core_save(c, *state);
    return fmi2OK;
}
fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate state) {
    if (!state) return refuse(c, "no state was saved");
    return event(c, core_restore(c, state, core_saved_size(c)), "restored a state, now");
}
fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate* state) {
    (void)c;
    if (state) {
        free(*state);
        *state = NULL;
    }
    return fmi2OK;
}
fmi2Status fmi2SerializedFMUstateSize(fmi2Component c, fmi2FMUstate state, size_t* size) {
    (void)state;
    *size = core_saved_size(c);
    return fmi2OK;
}
fmi2Status fmi2SerializeFMUstate(fmi2Component c, fmi2FMUstate state, fmi2Byte bytes[], size_t size) {
    if (!state || size < core_saved_size(c)) return refuse(c, "buffer too small for the saved state");
    memcpy(bytes, state, core_saved_size(c));
    return fmi2OK;
}
fmi2Status fmi2DeSerializeFMUstate(fmi2Component c, const fmi2Byte bytes[], size_t size, fmi2FMUstate* state) {
    if (core_check_saved(c, bytes, size)) return status(c, -1);
    if (!*state && !(*state = malloc(size))) return refuse(c, "out of memory");
    memcpy(*state, bytes, size);
    return fmi2OK;
}

fmi2Status fmi2DoStep(fmi2Component c, fmi2Real time, fmi2Real h, fmi2Boolean noSetFMUStatePrior) {
    (void)noSetFMUStatePrior;
    return status(c, core_step(c, time, h));
}
fmi2Status fmi2EnterEventMode(fmi2Component c) { return event(c, core_enter_event(c), "event"); }
fmi2Status fmi2EnterContinuousTimeMode(fmi2Component c) { return status(c, core_enter_time(c)); }
fmi2Status fmi2NewDiscreteStates(fmi2Component c, fmi2EventInfo* info) {
    int moved;
    double next;
    if (core_update(c, &moved, &next)) return status(c, -1);
    info->newDiscreteStatesNeeded = fmi2False;
    info->terminateSimulation = fmi2False;
    info->nominalsOfContinuousStatesChanged = fmi2False;
    info->valuesOfContinuousStatesChanged = moved ? fmi2True : fmi2False;
    info->nextEventTimeDefined = isfinite(next) ? fmi2True : fmi2False;
    info->nextEventTime = isfinite(next) ? next : 0;
    return fmi2OK;
}
fmi2Status fmi2CompletedIntegratorStep(fmi2Component c, fmi2Boolean noSetFMUStatePrior,
                                       fmi2Boolean* enterEventMode, fmi2Boolean* terminateSimulation) {
    (void)noSetFMUStatePrior;
    *enterEventMode = *terminateSimulation = fmi2False;
    return status(c, core_completed_step(c));
}
fmi2Status fmi2SetTime(fmi2Component c, fmi2Real time) { return status(c, core_set_time(c, time)); }
fmi2Status fmi2SetContinuousStates(fmi2Component c, const fmi2Real x[], size_t n) {
    return status(c, core_set_states(c, x, n));
}
fmi2Status fmi2GetContinuousStates(fmi2Component c, fmi2Real x[], size_t n) {
    return status(c, core_get_states(c, x, n));
}
fmi2Status fmi2GetDerivatives(fmi2Component c, fmi2Real derivatives[], size_t n) {
    return status(c, core_get_derivatives(c, derivatives, n));
}
fmi2Status fmi2GetEventIndicators(fmi2Component c, fmi2Real z[], size_t n) {
    return status(c, core_get_crossings(c, z, n));
}
fmi2Status fmi2GetNominalsOfContinuousStates(fmi2Component c, fmi2Real x[], size_t n) {
    return status(c, core_get_nominals(c, x, n));
}

fmi2Status fmi2CancelStep(fmi2Component c) { return refuse(c, "no step is pending"); }

fmi2Status fmi2GetDirectionalDerivative(fmi2Component c, const fmi2ValueReference unknown[],
                                        size_t nUnknown, const fmi2ValueReference known[],
                                        size_t nKnown, const fmi2Real seed[], fmi2Real result[]) {
    return status(c, core_derivative(c, unknown, nUnknown, known, nKnown, seed, result));
}
fmi2Status fmi2SetRealInputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t n,
                                       const fmi2Integer order[], const fmi2Real value[]) {
    (void)vr, (void)n, (void)order, (void)value;
    return refuse(c, "input derivatives are not supported");
}
fmi2Status fmi2GetRealOutputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t n,
                                        const fmi2Integer order[], fmi2Real value[]) {
    (void)vr, (void)n, (void)order, (void)value;
    return refuse(c, "output derivatives are not supported");
}

#define NO_PENDING_STATUS(NAME, TYPE)                                                \
    fmi2Status NAME(fmi2Component c, const fmi2StatusKind kind, TYPE* value) {       \
        (void)c, (void)kind, (void)value;                                            \
        return fmi2Discard;                                                          \
    }
NO_PENDING_STATUS(fmi2GetStatus, fmi2Status)
NO_PENDING_STATUS(fmi2GetIntegerStatus, fmi2Integer)
NO_PENDING_STATUS(fmi2GetBooleanStatus, fmi2Boolean)
NO_PENDING_STATUS(fmi2GetStringStatus, fmi2String)

fmi2Status fmi2GetRealStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Real* value) {
    if (kind != fmi2LastSuccessfulTime) return fmi2Discard;
    *value = ((Instance*)c)->state->time;
    return fmi2OK;
}
