/* A C importer without Python, compiled with -DFMI=2 or -DFMI=3: loads the library of an extracted
 * FMU, changes one start value, makes 1000 steps of 1 ms and prints the outputs with every bit.
 * On the way it is refused a few times, resets, saves its state as bytes and comes back to it.
 *
 *     host LIBRARY TOKEN RESOURCES CHANGED VALUE FIRST COUNT [STEPS INPUTS]
 *
 * CHANGED is the value reference of the start value, 0 for none; the outputs have the value
 * references FIRST .. FIRST + COUNT - 1. With INPUTS, the value references before FIRST are inputs and
 * change in each step.
 */
#ifdef _WIN32
#define WIN32_LEAN_AND_MEAN
#include <windows.h>
#define dlopen(PATH, MODE) ((void*)LoadLibraryA(PATH))
#define dlsym(LIBRARY, NAME) ((void*)GetProcAddress((HMODULE)(LIBRARY), NAME))
#define dlclose(LIBRARY) FreeLibrary((HMODULE)(LIBRARY))
#else
#include <dlfcn.h>
#endif
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static void *library, *c;

static void must(int ok, const char* what) {
    if (ok) return;
    fprintf(stderr, "failed: %s\n", what);
    exit(3);
}
static void* function(const char* name) {
    void* found = dlsym(library, name);
    must(found != NULL, name);
    return found;
}

#if FMI == 2
#include "fmi2FunctionTypes.h"
#define F(NAME) ((fmi2##NAME##TYPE*)function("fmi2" #NAME))
static void say(fmi2ComponentEnvironment environment, fmi2String name, fmi2Status status,
                fmi2String category, fmi2String format, ...) {
    va_list arguments;
    (void)environment, (void)name, (void)status, (void)category;
    va_start(arguments, format);
    vfprintf(stderr, format, arguments);
    va_end(arguments);
    fputc('\n', stderr);
}
static fmi2CallbackFunctions callbacks = {say, calloc, free, NULL, NULL};
static void* instantiate(const char* token, const char* resources) {
    return F(Instantiate)("host", fmi2CoSimulation, token, resources, &callbacks, 0, 0);
}
static int enter(void) { return F(SetupExperiment)(c, 0, 0, 0, 0, 0) || F(EnterInitializationMode)(c); }
static int get(const unsigned* vr, size_t n, double* y) { return F(GetReal)(c, vr, n, y); }
static int set(const unsigned* vr, size_t n, const double* y) { return F(SetReal)(c, vr, n, y); }
static int step(double t) { return F(DoStep)(c, t, 1e-3, fmi2True); }
static int save(void** s) { return F(GetFMUstate)(c, s); }
static int restore(void* s) { return F(SetFMUstate)(c, s); }
static int drop(void** s) { return F(FreeFMUstate)(c, s); }
static int size_of(void* s, size_t* n) { return F(SerializedFMUstateSize)(c, s, n); }
static int write(void* s, char* b, size_t n) { return F(SerializeFMUstate)(c, s, b, n); }
static int read(const char* b, size_t n, void** s) { return F(DeSerializeFMUstate)(c, b, n, s); }
#else
#include "fmi3FunctionTypes.h"
#define F(NAME) ((fmi3##NAME##TYPE*)function("fmi3" #NAME))
static void say(fmi3InstanceEnvironment environment, fmi3Status status, fmi3String category, fmi3String text) {
    (void)environment, (void)status, (void)category;
    fprintf(stderr, "%s\n", text);
}
static void* instantiate(const char* token, const char* resources) {
    return F(InstantiateCoSimulation)("host", token, resources, 0, 0, 0, 0, NULL, 0, NULL, say, NULL);
}
static int enter(void) { return F(EnterInitializationMode)(c, 0, 0, 0, 0, 0); }
static int get(const unsigned* vr, size_t n, double* y) { return F(GetFloat64)(c, vr, n, y, n); }
static int set(const unsigned* vr, size_t n, const double* y) { return F(SetFloat64)(c, vr, n, y, n); }
static int step(double t) {
    fmi3Boolean event, terminate, early;
    double last;
    return F(DoStep)(c, t, 1e-3, fmi3True, &event, &terminate, &early, &last);
}
static int save(void** s) { return F(GetFMUState)(c, s); }
static int restore(void* s) { return F(SetFMUState)(c, s); }
static int drop(void** s) { return F(FreeFMUState)(c, s); }
static int size_of(void* s, size_t* n) { return F(SerializedFMUStateSize)(c, s, n); }
static int write(void* s, char* b, size_t n) { return F(SerializeFMUState)(c, s, (fmi3Byte*)b, n); }
static int read(const char* b, size_t n, void** s) {
    return F(DeserializeFMUState)(c, (const fmi3Byte*)b, n, s);
}
#endif

int main(int argc, char** argv) {
    must(argc == 8 || argc == 10, "seven or nine arguments");
    unsigned vr[256], changed = (unsigned)atoi(argv[4]), bad = 99999, count = (unsigned)atoi(argv[7]);
    unsigned inputs = argc > 8 ? (unsigned)atoi(argv[9]) : 0, input_vr[64];
    int all = argc > 8 ? atoi(argv[8]) : 1000;
    double start = atof(argv[5]), y[256], again[256], middle[64], u;
    char bytes[1 << 16];
    size_t size;
    void *saved = NULL, *rebuilt = NULL;
    must(count <= 256 && inputs <= 64, "at most 256 outputs and 64 inputs");
    for (unsigned i = 0; i < count; i++) vr[i] = (unsigned)atoi(argv[6]) + i;
    for (unsigned i = 0; i < inputs; i++) input_vr[i] = vr[0] - inputs + i;
    library = dlopen(argv[1], RTLD_NOW | RTLD_LOCAL);
    must(library != NULL, "dlopen");
    must(instantiate("wrong", argv[3]) == NULL, "refusal of a wrong token");
    c = instantiate(argv[2], argv[3]);
    must(c != NULL, "instantiate");

    for (int steps = 10; steps; steps = steps == 10 ? all : 0) { /* once in vain, then after a reset */
        must(step(0) != 0, "refusal of a step before initialization");
        if (changed) must(set(&changed, 1, &start) == 0, "set");
        must(enter() == 0 && F(ExitInitializationMode)(c) == 0, "initialization");
        if (inputs) must(get(input_vr, inputs, middle) == 0, "get the inputs");
        for (int k = 0; k < steps; k++) {
            for (unsigned i = 0; i < inputs; i++) { /* around the start value, or next to nothing */
                u = ((unsigned)k * 7919u + i * 1009u) % 4096u / 40960.0;
                u = middle[i] != 0 ? middle[i] * (0.95 + u) : (0.5 + u) / 1e5;
                must(set(&input_vr[i], 1, &u) == 0, "set an input");
            }
            must(step(k * 1e-3) == 0 && get(vr, count, y) == 0, "step");
            for (unsigned i = 0; steps == all && i < count; i++) printf("%.17g\n", y[i]);
            if (k != 500) continue;
            must(save(&saved) == 0 && size_of(saved, &size) == 0 && size <= sizeof bytes, "save");
            must(write(saved, bytes, size) == 0, "serialize");
            must(read(bytes, size - 1, &rebuilt) != 0, "refusal of a short state");
            must(read(bytes, size, &rebuilt) == 0, "deserialize");
            must(step(0.501) == 0 && restore(rebuilt) == 0 && get(vr, count, again) == 0, "restore");
            must(memcmp(y, again, count * sizeof *y) == 0, "the same outputs after restoring");
            must(drop(&saved) == 0 && drop(&rebuilt) == 0, "free the states");
        }
        must(step(-7) != 0 && get(&bad, 1, y) != 0, "refusals");
        if (steps == 10) must(F(Reset)(c) == 0, "reset");
    }
    must(F(Terminate)(c) == 0, "terminate");
    F(FreeInstance)(c);
    dlclose(library);
    return 0;
}
