/* An FMI 2 slave that counts its steps, and misbehaves as the name of its instance says. */
#define _GNU_SOURCE
#include <errno.h>
#include <fcntl.h>
#include <fenv.h>
#include <locale.h>
#include <math.h>
#include <pthread.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>
#ifdef __SSE__
#include <xmmintrin.h>
#endif

#include "fmi2Functions.h"

#define BAD_STEP 5

static char kind[64];
static const fmi2CallbackFunctions *host;
static int steps, slow, began;
static double y, bad = 1;

static int is(const char *name) { return strcmp(kind, name) == 0; }
static void say(const char *text) { host->logger(host->componentEnvironment, kind, fmi2Error, "", text); }
static void forever(void) { for (;;) pause(); }
static int deep(volatile int n) { volatile char b[4096]; b[0] = (char)n; return deep(n + 1) + b[0]; }
static void *crash_later(void *unused) { (void)unused; usleep(30000); abort(); }
static void grow(void) {
    for (;;) {
        char *block = malloc(1 << 24);
        if (!block) abort();
        memset(block, 1, 1 << 24);
    }
}
/* Rounds down from the call that the name ends with on: "rounds_in_Instantiate". */
static void round_in(const char *call) {
    if (strncmp(kind, "rounds_in_", 10) == 0 && strcmp(kind + 10, call) == 0) fesetround(FE_DOWNWARD);
}
static void answer(const char *text) { for (int i = 3; i < 256; i++) (void)!write(i, text, strlen(text)); }
/* Zeros into every shared file that is mapped or open. */
static void punch(void) {
    char line[512];
    FILE *maps = fopen("/proc/self/maps", "r");
    while (maps && fgets(line, sizeof line, maps)) {
        unsigned long from, to;
        if (strstr(line, "memfd:uavtwin") && sscanf(line, "%lx-%lx", &from, &to) == 2) madvise((void *)from, to - from, MADV_REMOVE);
    }
    if (maps) fclose(maps);
}
static void survive(int number) { (void)number; }

fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String location,
                              const fmi2CallbackFunctions *callbacks, fmi2Boolean visible, fmi2Boolean logging) {
    (void)type; (void)guid; (void)location; (void)visible; (void)logging;
    host = callbacks;
    strncpy(kind, name, sizeof kind - 1);
    steps = 0, y = 0, bad = 1;
    round_in("Instantiate");
    if (is("wrong_guid")) { say("the GUID is another"); return NULL; }
    if (is("loop_in_instantiate")) for (;;) {}
    if (is("exit_in_instantiate")) exit(0);
    return (fmi2Component)kind;
}

static fmi2Status bad_step(void) {
    if (is("exit0")) exit(0);
    if (is("exit3")) exit(3);
    if (is("underscore_exit")) _exit(0);
    if (is("abort")) abort();
    if (is("segv")) *(volatile int *)8 = 1;
    if (is("stack_overflow")) return deep(0) ? fmi2OK : fmi2Warning;
    if (is("divide_by_zero")) raise(SIGFPE);
    if (is("loop_in_step")) for (;;) {}
    if (is("sleep_in_step")) forever();
    if (is("stops_itself")) raise(SIGSTOP);
    if (is("nan")) y = NAN;
    if (is("inf")) y = INFINITY;
    if (is("error")) { say("this went wrong"); return fmi2Error; }
    if (is("discard") || is("negative_time")) return fmi2Discard;
    if (is("fatal") || is("fatal_reset_never")) return fmi2Fatal;
    if (is("pending")) return fmi2Pending;
    if (is("unknown_status")) return (fmi2Status)77;
    if (is("memory")) grow();
    if (is("prints")) { printf("nonsense\n{\"a\": 1}\n"); fflush(stdout); fprintf(stderr, "error: nonsense\n"); }
    if (is("prints_a_lot")) { for (int i = 0; i < 100000; i++) puts("a line that nobody wants to read"); fflush(stdout); }
    if (is("says_escapes")) { say("\033[2J\033[31mall\nis\rwell"); return fmi2Error; }
    if (is("closes_stdout")) { close(1); close(2); }
    if (is("closes_all")) for (int i = 0; i < 256; i++) close(i);
    if (is("writes_all")) for (int i = 3; i < 256; i++) (void)!write(i, "{\"a\": 1}\n", 9);
    if (is("truncates_all")) for (int i = 3; i < 256; i++) (void)!ftruncate(i, 0);
    if (is("extends_all")) for (int i = 3; i < 256; i++) (void)!ftruncate(i, (off_t)1 << 46);
    if (is("punches_all")) punch();
    if (is("answers_done")) answer("{\"done\": 3}\n");
    if (is("answers_progress")) answer("{\"progress\": {}}\n");
    if (is("answers_nan")) answer("{\"progress\": NaN}\n");
    if (is("answers_deep")) { char text[3000]; memset(text, '[', 2998); text[2998] = '\n'; text[2999] = 0; answer(text); }
    if (is("chdir")) (void)!chdir("/");
    if (is("umask")) umask(0777);
    if (is("locale")) setlocale(LC_ALL, "de_DE.UTF-8");
    if (is("rounding")) fesetround(FE_DOWNWARD);
#ifdef __SSE__
    if (is("flush_to_zero")) _mm_setcsr(_mm_getcsr() | 0x8040);
#endif
    if (is("fork_stays") && fork() == 0) forever();
    if (is("fork_returns")) (void)!fork();
    if (is("thread")) { pthread_t t; pthread_create(&t, NULL, crash_later, NULL); slow = 1; }
    if (is("signals")) { for (int i = 1; i < 64; i++) signal(i, survive); raise(SIGTERM); for (;;) {} }
    if (is("interrupts")) raise(SIGINT);
    if (is("alarm")) { alarm(1); slow = 100; }
    if (is("kills_group")) kill(0, SIGKILL);
    if (is("leaves_files")) { FILE *f = fopen("left", "w"); if (f) fclose(f); }
    return fmi2OK;
}

fmi2Status fmi2DoStep(fmi2Component c, fmi2Real t, fmi2Real h, fmi2Boolean back) {
    (void)c; (void)t; (void)h; (void)back;
    y = ++steps;
    fmi2Status status = steps == BAD_STEP && bad >= 0.5 ? bad_step() : fmi2OK;
    if (slow) usleep(10000 * slow);
    return status;
}

fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Real value[]) {
    (void)c; (void)vr;
    round_in("GetReal");
    if (is("exit_in_get") && steps == BAD_STEP) exit(0);
    for (size_t i = 0; i < n; i++) value[i] = y;
    return fmi2OK;
}

fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Real value[]) {
    (void)c;
    round_in("SetReal");
    for (size_t i = 0; i < n; i++) if (vr[i] == 1) bad = value[i];
    return fmi2OK;
}

fmi2Status fmi2GetRealStatus(fmi2Component c, const fmi2StatusKind s, fmi2Real *value) {
    (void)c; (void)s;
    *value = is("negative_time") ? -7 : 0.4;
    return fmi2OK;
}

fmi2Status fmi2EnterInitializationMode(fmi2Component c) {
    (void)c;
    began = 1; /* from here on fmi2Reset has something to do */
    round_in("EnterInitializationMode");
    if (is("segv_in_initialization")) *(volatile int *)8 = 1;
    if (is("nan_at_start")) y = NAN;
    return fmi2OK;
}

fmi2Status fmi2Terminate(fmi2Component c) {
    (void)c;
    if (is("loop_in_terminate")) for (;;) {}
    if (is("exit_in_terminate")) exit(0);
    return fmi2OK;
}

void fmi2FreeInstance(fmi2Component c) {
    (void)c;
    round_in("FreeInstance");
    if (is("segv_in_free")) *(volatile int *)8 = 1;
}

fmi2Status fmi2Reset(fmi2Component c) {
    (void)c;
    int first = !began, never = is("reset_never") || is("fatal_reset_never");
    if ((is("reset_later") && first) || never) { say("cannot be reset"); return fmi2Error; }
    if ((is("reset_later_or_segv") && first) || is("reset_segv")) *(volatile int *)8 = 1;
    steps = 0; y = 0; bad = 1; began = 0;
    return fmi2OK;
}
const char *fmi2GetTypesPlatform(void) { return "default"; }
const char *fmi2GetVersion(void) { return "2.0"; }
#define FINE(name, ...) fmi2Status name(__VA_ARGS__) { return fmi2OK; }
#define GET(T) FINE(fmi2Get##T, fmi2Component c, const fmi2ValueReference v[], size_t n, fmi2##T x[])
#define SET(T) FINE(fmi2Set##T, fmi2Component c, const fmi2ValueReference v[], size_t n, const fmi2##T x[])
GET(Integer) GET(Boolean) GET(String) SET(Integer) SET(Boolean) SET(String)
FINE(fmi2SetDebugLogging, fmi2Component c, fmi2Boolean on, size_t n, const fmi2String names[])
FINE(fmi2SetupExperiment, fmi2Component c, fmi2Boolean d, fmi2Real tol, fmi2Real start, fmi2Boolean s, fmi2Real stop)
#ifndef MISSING
FINE(fmi2ExitInitializationMode, fmi2Component c)
#endif
FINE(fmi2GetFMUstate, fmi2Component c, fmi2FMUstate *s)
FINE(fmi2SetFMUstate, fmi2Component c, fmi2FMUstate s)
FINE(fmi2FreeFMUstate, fmi2Component c, fmi2FMUstate *s)
FINE(fmi2SerializedFMUstateSize, fmi2Component c, fmi2FMUstate s, size_t *n)
FINE(fmi2SerializeFMUstate, fmi2Component c, fmi2FMUstate s, fmi2Byte b[], size_t n)
FINE(fmi2DeSerializeFMUstate, fmi2Component c, const fmi2Byte b[], size_t n, fmi2FMUstate *s)
FINE(fmi2GetDirectionalDerivative, fmi2Component c, const fmi2ValueReference u[], size_t m,
     const fmi2ValueReference k[], size_t n, const fmi2Real d[], fmi2Real r[])
FINE(fmi2SetRealInputDerivatives, fmi2Component c, const fmi2ValueReference v[], size_t n, const fmi2Integer o[],
     const fmi2Real x[])
FINE(fmi2GetRealOutputDerivatives, fmi2Component c, const fmi2ValueReference v[], size_t n, const fmi2Integer o[],
     fmi2Real x[])
FINE(fmi2CancelStep, fmi2Component c)
FINE(fmi2GetStatus, fmi2Component c, const fmi2StatusKind s, fmi2Status *v)
FINE(fmi2GetIntegerStatus, fmi2Component c, const fmi2StatusKind s, fmi2Integer *v)
FINE(fmi2GetBooleanStatus, fmi2Component c, const fmi2StatusKind s, fmi2Boolean *v)
FINE(fmi2GetStringStatus, fmi2Component c, const fmi2StatusKind s, fmi2String *v)
