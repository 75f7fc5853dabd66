/* Small FMUs after the models of the Reference FMUs of the Modelica Association, written anew from
 * their equations: -DMODEL=DAHLQUIST and so on, -DFMI=2 or 3; see reference_fmu.py. Each steps by a
 * fixed step of its own, and compares the stop time as it is. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define DAHLQUIST 1
#define VAN_DER_POL 2
#define BOUNCING_BALL 3
#define STAIR 4
#define FEEDTHROUGH 5
#define RESOURCE 6
#define STATE_SPACE 7
#define X __attribute__((visibility("default")))
enum { OK, WARNING, DISCARD, ERROR };

typedef struct {
    double time, stop;
    long steps; /* of H since the start */
    int initialized, ended;
    double r[40]; /* all variables as numbers, by value reference */
    char resources[4096];
} Me;

#if MODEL == DAHLQUIST /* der(x) = -k x; 1 x, 2 k */
static const double H = 0.1;
static void start(Me* m) { m->r[1] = 1, m->r[2] = 1; }
static void step(Me* m) { m->r[1] += H * -m->r[2] * m->r[1]; }
static void outputs(Me* m) { (void)m; }
#elif MODEL == VAN_DER_POL /* der(x0) = x1, der(x1) = mu (1 - x0^2) x1 - x0; 1 x0, 2 x1, 3 mu */
static const double H = 0.01;
static void start(Me* m) { m->r[1] = 2, m->r[2] = 0, m->r[3] = 1; }
static void step(Me* m) {
    const double x0 = m->r[1], x1 = m->r[2];
    m->r[1] += H * x1;
    m->r[2] += H * (m->r[3] * (1 - x0 * x0) * x1 - x0);
}
static void outputs(Me* m) { (void)m; }
#elif MODEL == BOUNCING_BALL /* 1 h, 2 v, 3 g, 4 e, 5 v_min */
static const double H = 0.001;
static void start(Me* m) { m->r[1] = 1, m->r[2] = 0, m->r[3] = -9.81, m->r[4] = 0.7, m->r[5] = 0.1; }
static void step(Me* m) {
    m->r[1] += H * m->r[2];
    m->r[2] += H * m->r[3];
    if (m->r[1] <= 0 && m->r[2] < 0) {
        m->r[1] = 0;
        m->r[2] *= -m->r[4];
        if (m->r[2] < m->r[5]) m->r[2] = m->r[3] = 0;
    }
}
static void outputs(Me* m) { (void)m; }
#elif MODEL == STAIR /* 1 counter, which counts seconds and ends the simulation at 10 */
static const double H = 0.2;
static void start(Me* m) { m->r[1] = 1; }
static void step(Me* m) {
    if (m->steps % 5 == 0) m->r[1] += 1;
    if (m->r[1] >= 11) m->ended = 1;
}
static void outputs(Me* m) { (void)m; }
#elif MODEL == FEEDTHROUGH /* inputs 1 to 5, outputs 11 to 15: Real, discrete Real, Integer, Boolean, Enumeration */
static const double H = 0.1;
static void start(Me* m) { m->r[5] = 1; }
static void step(Me* m) { (void)m; }
static void outputs(Me* m) { memcpy(m->r + 11, m->r + 1, 5 * sizeof(double)); }
#elif MODEL == RESOURCE /* 1 y: the first byte of a file */
static const double H = 0.1;
static void start(Me* m) {
    char path[4200];
    const char* at = strncmp(m->resources, "file:", 5) ? m->resources : m->resources + 5;
    while (at[0] == '/' && at[1] == '/') at++;
    const size_t n = strlen(at);
    snprintf(path, sizeof path, "%s%sy.txt", at, n && at[n - 1] == '/' ? "" : "/");
    FILE* file = fopen(path, "rb");
    m->r[1] = file ? fgetc(file) : -1;
    if (file) fclose(file);
}
static void step(Me* m) { (void)m; }
static void outputs(Me* m) { (void)m; }
#elif MODEL == STATE_SPACE /* der(x) = A x + B u, y = C x + D u; 1 to 3 u, 11 to 13 y, 21 to 23 x */
static const double H = 0.1;
static const double A[3][3] = {{0, 1, 0}, {-1, -0.4, 0.2}, {0, 0.3, -0.5}}, D[3] = {0, 0.5, 1};
static void start(Me* m) { for (int i = 0; i < 3; i++) m->r[1 + i] = i + 1, m->r[21 + i] = 0; }
static void step(Me* m) {
    double x[3];
    for (int i = 0; i < 3; i++) {
        x[i] = m->r[21 + i] + H * m->r[1 + i];
        for (int k = 0; k < 3; k++) x[i] += H * A[i][k] * m->r[21 + k];
    }
    memcpy(m->r + 21, x, sizeof x);
}
static void outputs(Me* m) { for (int i = 0; i < 3; i++) m->r[11 + i] = m->r[21 + i] + D[i] * m->r[1 + i]; }
#endif

static Me* make(const char* resources) {
    Me* m = calloc(1, sizeof *m);
    snprintf(m->resources, sizeof m->resources, "%s", resources ? resources : "");
    start(m);
    m->stop = HUGE_VAL;
    return m;
}
static int reset(Me* m) {
    Me* fresh = make(m->resources);
    *m = *fresh;
    free(fresh);
    return OK;
}
static int do_step(Me* m, double t, double h) {
    const long n = lround(h / H);
    if (!m->initialized || m->ended || fabs(t - m->time) > 1e-9 || n < 1 || fabs(n * H - h) > 1e-9) return ERROR;
    if (t + h > m->stop) return ERROR;
    for (long k = 0; k < n && !m->ended; k++) {
        m->steps++;
        step(m);
    }
    m->time = t + h;
    return OK;
}

#define GET(NAME, TYPE, ...)                                                                   \
    X int NAME(Me* m, const unsigned vr[], size_t n, TYPE value[] __VA_ARGS__) {               \
        outputs(m);                                                                            \
        for (size_t i = 0; i < n; i++) value[i] = (TYPE)(vr[i] ? m->r[vr[i]] : m->time);       \
        return OK;                                                                             \
    }
#define SET(NAME, TYPE, ...)                                                                   \
    X int NAME(Me* m, const unsigned vr[], size_t n, const TYPE value[] __VA_ARGS__) {         \
        for (size_t i = 0; i < n; i++) m->r[vr[i]] = (double)value[i];                         \
        return OK;                                                                             \
    }
#define NO(NAME) X int NAME() { return ERROR; }
#if FMI == 2
X const char* fmi2GetTypesPlatform(void) { return "default"; }
X const char* fmi2GetVersion(void) { return "2.0"; }
X void* fmi2Instantiate(const char* n, int t, const char* g, const char* r, const void* f, int v, int l) {
    (void)n, (void)t, (void)g, (void)f, (void)v, (void)l;
    return make(r);
}
X void fmi2FreeInstance(Me* m) { free(m); }
X int fmi2SetDebugLogging(Me* m) { (void)m; return OK; }
X int fmi2SetupExperiment(Me* m, int td, double tol, double t, int stops, double stop) {
    (void)td, (void)tol;
    m->time = t;
    m->stop = stops ? stop : HUGE_VAL;
    return OK;
}
X int fmi2EnterInitializationMode(Me* m) { (void)m; return OK; }
X int fmi2ExitInitializationMode(Me* m) { m->initialized = 1; return OK; }
X int fmi2Terminate(Me* m) { (void)m; return OK; }
X int fmi2Reset(Me* m) { return reset(m); }
GET(fmi2GetReal, double) GET(fmi2GetInteger, int) GET(fmi2GetBoolean, int)
SET(fmi2SetReal, double) SET(fmi2SetInteger, int) SET(fmi2SetBoolean, int)
X int fmi2DoStep(Me* m, double t, double h, int p) {
    (void)p;
    const int status = do_step(m, t, h);
    return status == OK && m->ended ? DISCARD : status;
}
X int fmi2GetBooleanStatus(Me* m, int kind, int* value) { *value = m->ended; return kind == 3 ? OK : DISCARD; }
X int fmi2GetRealStatus(Me* m, int kind, double* value) { *value = m->time; return kind == 2 ? OK : DISCARD; }
NO(fmi2GetString) NO(fmi2SetString) NO(fmi2GetFMUstate) NO(fmi2SetFMUstate) NO(fmi2FreeFMUstate)
NO(fmi2SerializedFMUstateSize) NO(fmi2SerializeFMUstate) NO(fmi2DeSerializeFMUstate)
NO(fmi2GetDirectionalDerivative) NO(fmi2SetRealInputDerivatives) NO(fmi2GetRealOutputDerivatives)
NO(fmi2CancelStep) NO(fmi2GetStatus) NO(fmi2GetIntegerStatus) NO(fmi2GetStringStatus)
#else
#include <stdbool.h>
#include <stdint.h>
#define SIZE , size_t size
X const char* fmi3GetVersion(void) { return "3.0"; }
X void* fmi3InstantiateCoSimulation(const char* n, const char* g, const char* r) { (void)n, (void)g; return make(r); }
X void fmi3FreeInstance(Me* m) { free(m); }
X int fmi3SetDebugLogging(Me* m) { (void)m; return OK; }
X int fmi3EnterInitializationMode(Me* m, bool td, double tol, double t, bool stops, double stop) {
    (void)td, (void)tol;
    m->time = t;
    m->stop = stops ? stop : HUGE_VAL;
    return OK;
}
X int fmi3ExitInitializationMode(Me* m) { m->initialized = 1; return OK; }
X int fmi3Terminate(Me* m) { (void)m; return OK; }
X int fmi3Reset(Me* m) { return reset(m); }
#if MODEL == STATE_SPACE /* a variable has three elements */
X int fmi3GetFloat64(Me* m, const unsigned vr[], size_t n, double value[], size_t size) {
    outputs(m);
    for (size_t i = 0; i < n; i++)
        for (int k = 0; k < (vr[i] ? 3 : 1); k++) *value++ = vr[i] ? m->r[vr[i] + k] : m->time;
    return (void)size, OK;
}
X int fmi3SetFloat64(Me* m, const unsigned vr[], size_t n, const double value[], size_t size) {
    for (size_t i = 0; i < n; i++)
        for (int k = 0; k < 3; k++) m->r[vr[i] + k] = *value++;
    return (void)size, OK;
}
#else
GET(fmi3GetFloat64, double, SIZE) SET(fmi3SetFloat64, double, SIZE)
#endif
GET(fmi3GetInt32, int32_t, SIZE) GET(fmi3GetBoolean, bool, SIZE) GET(fmi3GetInt64, int64_t, SIZE)
SET(fmi3SetInt32, int32_t, SIZE) SET(fmi3SetBoolean, bool, SIZE) SET(fmi3SetInt64, int64_t, SIZE)
X int fmi3DoStep(Me* m, double t, double h, bool p, bool* event, bool* ends, bool* early, double* last) {
    (void)p;
    const int status = do_step(m, t, h);
    *event = *early = false;
    *ends = m->ended != 0;
    *last = m->time;
    return status;
}
#define NONE(TYPE) NO(fmi3Get##TYPE) NO(fmi3Set##TYPE)
NONE(Float32) NONE(Int8) NONE(UInt8) NONE(Int16) NONE(UInt16) NONE(UInt32) NONE(UInt64) NONE(String) NONE(Binary)
NONE(Clock) NONE(FMUState) NO(fmi3FreeFMUState) NO(fmi3SerializedFMUStateSize) NO(fmi3SerializeFMUState)
NO(fmi3DeserializeFMUState) NO(fmi3InstantiateModelExchange) NO(fmi3InstantiateScheduledExecution)
NO(fmi3GetDirectionalDerivative) NO(fmi3GetAdjointDerivative) NO(fmi3EnterConfigurationMode)
NO(fmi3ExitConfigurationMode) NO(fmi3EnterEventMode) NO(fmi3EnterStepMode) NO(fmi3EnterContinuousTimeMode)
NO(fmi3GetNumberOfVariableDependencies) NO(fmi3GetVariableDependencies) NO(fmi3GetIntervalDecimal)
NO(fmi3GetIntervalFraction) NO(fmi3GetShiftDecimal) NO(fmi3GetShiftFraction) NO(fmi3SetIntervalDecimal)
NO(fmi3SetIntervalFraction) NO(fmi3SetShiftDecimal) NO(fmi3SetShiftFraction) NO(fmi3EvaluateDiscreteStates)
NO(fmi3UpdateDiscreteStates) NO(fmi3GetOutputDerivatives) NO(fmi3ActivateModelPartition)
NO(fmi3CompletedIntegratorStep) NO(fmi3SetTime) NO(fmi3SetContinuousStates) NO(fmi3GetContinuousStates)
NO(fmi3GetContinuousStateDerivatives) NO(fmi3GetEventIndicators) NO(fmi3GetNominalsOfContinuousStates)
NO(fmi3GetNumberOfContinuousStates) NO(fmi3GetNumberOfEventIndicators)
#endif
