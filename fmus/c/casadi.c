/* A CasADi component as a model: its kernels, generated into kernels.h, behind core.h.
 *
 * A kernel reads its arguments while it writes its results, so the two never share a buffer.
 */
#include "core.h"
#ifdef SAMPLE_PERIOD
#include "noise.h"
#endif
#include "kernels.h"

#define PARAMETERS (s->v + 1)
#define INPUTS (s->v + FIRST_INPUT)

/* Call a kernel: KERNEL, where its result goes, its arguments. Work space is on the stack. */
#define CALL(KERNEL, RESULT, ...)                         \
    do {                                                  \
        const double* arg[N_ARGUMENTS] = {__VA_ARGS__};   \
        double* res[N_RESULTS] = {RESULT};                \
        int iw[N_INTEGERS];                               \
        double w[N_WORK];                                 \
        KERNEL(arg, res, iw, w, 0);                       \
    } while (0)

int model_open(const char* resources, void** data, char* message, size_t size) {
    (void)resources, (void)message, (void)size;
    *data = NULL;
    return 0;
}
void model_close(void* data) { (void)data; }

void model_initial(const State* s, const void* data, double* x) {
    (void)data;
    CALL(initial, x, INPUTS, PARAMETERS);
}

void model_step(const State* s, const void* data, double h, double* x_next) {
    (void)data;
#ifdef HAS_SHORTCUT
    double cheap = 0;
    CALL(holds, &cheap, s->x, PARAMETERS, &h);
    if (cheap) {
        CALL(cheap_step, x_next, s->x, INPUTS, PARAMETERS, &h);
        return;
    }
#endif
    CALL(step, x_next, s->x, INPUTS, PARAMETERS, &h);
}

void model_outputs(State* s, void* data) {
    (void)data;
    CALL(outputs, s->v + FIRST_OUTPUT, s->x, INPUTS, PARAMETERS);
}

void model_tangent(const State* s, const void* data, int initializing, double* change) {
    (void)data;
    const double *d_p = change + 1, *d_u = change + FIRST_INPUT;
    double* d_y = change + FIRST_OUTPUT;
    if (!initializing) {
        CALL(tangent, d_y, s->x, INPUTS, PARAMETERS, d_u, d_p);
        return;
    }
#ifdef SAMPLE_PERIOD
    double noise[N_NOISE + 1]; /* the first sample instant is part of the start */
    standard_normal((uint64_t)s->v[SEED], STREAM, N_NOISE, 0, noise);
    CALL(initial_tangent, d_y, INPUTS, PARAMETERS, d_u, d_p, noise);
#else
    CALL(initial_tangent, d_y, INPUTS, PARAMETERS, d_u, d_p);
#endif
}

#ifdef SAMPLE_PERIOD
void model_update(const State* s, const void* data, const double* noise, double* x_next) {
    (void)data;
    CALL(update, x_next, s->x, INPUTS, PARAMETERS, noise);
}
#endif
