#include "core.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

/* As in the Python reference, twin/component.py. */
#define SAMPLE_TOLERANCE 1e-6

static int fail(Instance* c, const char* format, const char* name, double a, double b) {
    snprintf(c->message, sizeof c->message, format, name, a, b);
    return -1;
}

void core_reset(Instance* c) {
    memset(&c->state, 0, sizeof c->state);
    for (unsigned i = 1; i < FIRST_OUTPUT; i++) c->state.v[i] = variables[i].start;
    c->state.mode = INSTANTIATED;
    c->state.outputs_stale = 1;
}

Instance* core_new(const char* resources, char* message, size_t size) {
    Instance* c = calloc(1, sizeof *c);
    if (!c) {
        snprintf(message, size, "out of memory");
        return NULL;
    }
    if (model_open(resources, &c->data, message, size) != 0) {
        free(c);
        return NULL;
    }
    core_reset(c);
    return c;
}

void core_free(Instance* c) {
    if (!c) return;
    model_close(c->data);
    free(c);
}

#ifdef SAMPLE_PERIOD
#include "noise.h"

static void sample(Instance* c) {
    State* s = &c->state;
    double noise[N_NOISE + 1], next[N_STATES + 1];
    standard_normal((uint64_t)s->v[SEED], STREAM, N_NOISE, (uint64_t)s->samples, noise);
    model_update(s, c->data, noise, next);
    memcpy(s->x, next, N_STATES * sizeof(double));
}
#endif

/* States at the start, the first sample instant included. */
static void begin(Instance* c) {
    model_initial(&c->state, c->data, c->state.x);
    c->state.start_time = c->state.v[0];
    c->state.samples = 0;
#ifdef SAMPLE_PERIOD
    sample(c);
#endif
}

int core_get(Instance* c, unsigned vr, double* value) {
    State* s = &c->state;
    if (vr >= N_VARIABLES) return fail(c, "%sno variable has value reference %.0f", "", vr, 0);
    if (vr >= FIRST_OUTPUT && s->outputs_stale) {
        if (s->mode < STEPPING) begin(c);
        model_outputs(s, c->data);
        for (unsigned i = FIRST_OUTPUT; i < N_VARIABLES; i++)
            if (!isfinite(s->v[i]))
                return fail(c, "output %s = %g at time %g s is not a finite number", variables[i].name,
                            s->v[i], s->v[0]);
        s->outputs_stale = 0;
    }
    *value = s->v[vr];
    return 0;
}

int core_set(Instance* c, unsigned vr, double value) {
    State* s = &c->state;
    if (vr == 0 || vr >= N_VARIABLES)
        return fail(c, "%sno settable variable has value reference %.0f", "", vr, 0);
    const Variable* k = &variables[vr];
    if (k->causality == OUTPUT) return fail(c, "%s is an output and cannot be set", k->name, 0, 0);
    if (k->causality == FIXED_PARAMETER && s->mode >= STEPPING)
        return fail(c, "%s is fixed once initialization has ended; reset the FMU first", k->name, 0, 0);
    if (!isfinite(value))
        return fail(c, "%s = %g at time %g s is not a finite number", k->name, value, s->v[0]);
    if (value < k->minimum) return fail(c, "%s = %g is below its minimum %g", k->name, value, k->minimum);
    if (value > k->maximum) return fail(c, "%s = %g is above its maximum %g", k->name, value, k->maximum);
    s->v[vr] = value;
    s->outputs_stale = 1;
    return 0;
}

int core_enter_initialization(Instance* c, double start_time) {
    if (c->state.mode != INSTANTIATED)
        return fail(c, "%sinitialization was entered twice; reset the FMU first", "", 0, 0);
    if (!isfinite(start_time)) return fail(c, "%sstart time %g is not finite", "", start_time, 0);
    c->state.v[0] = start_time;
    c->state.mode = INITIALIZING;
    c->state.outputs_stale = 1;
    return 0;
}

static int check_finite(Instance* c) {
    for (int i = 0; i < N_STATES; i++)
        if (!isfinite(c->state.x[i]))
            return fail(c, "state %s = %g at time %g s: the simulation has diverged", state_names[i],
                        c->state.x[i], c->state.v[0]);
    return 0;
}

/* Integrate over a time without sample instants, in equal parts of at most MAX_STEP. */
static void integrate(Instance* c, double h) {
    State* s = &c->state;
    double next[N_STATES + 1], n = ceil(h / MAX_STEP - 1e-6);
    if (n < 1) n = 1;
    double dt = h / n;
    for (long k = 0; N_STATES > 0 && k < (long)n; k++) {
        model_step(s, c->data, dt, next);
        memcpy(s->x, next, N_STATES * sizeof(double));
    }
}

int core_exit_initialization(Instance* c) {
    if (c->state.mode != INITIALIZING) return fail(c, "%sinitialization was not entered", "", 0, 0);
    begin(c);
    c->state.mode = STEPPING;
    c->state.outputs_stale = 1;
    return check_finite(c);
}

int core_step(Instance* c, double time, double h) {
    State* s = &c->state;
    if (s->mode != STEPPING) return fail(c, "%sdoStep before initialization or after terminate", "", 0, 0);
    if (!(h > 0) || !isfinite(h))
        return fail(c, "%scommunication step size %g s must be positive", "", h, 0);
    if (!(fabs(time - s->v[0]) <= 1e-3 * h))
        return fail(c, "%sdoStep at %.9g s, but the FMU is at %.9g s", "", time, s->v[0]);
    if (h / MAX_STEP > 1e9) return fail(c, "%scommunication step size %g s is too long", "", h, 0);
#ifdef SAMPLE_PERIOD
    const double period = s->v[SAMPLE_PERIOD], slack = SAMPLE_TOLERANCE * period;
    double now = time, left = h;
    for (;;) {
        double ahead = s->start_time + (s->samples + 1) * period - now;
        int due = ahead <= left + slack;
        double part = due && ahead < left - slack ? ahead : left;
        if (part > slack) integrate(c, part);
        now += part;
        left -= part;
        if (!due) break;
        s->samples += 1;
        sample(c);
    }
#else
    integrate(c, h);
#endif
    s->v[0] = time + h;
    s->outputs_stale = 1;
    return check_finite(c);
}

int core_derivative(Instance* c, const unsigned unknown[], size_t n_unknown, const unsigned known[],
                    size_t n_known, const double seed[], double result[]) {
    double change[N_VARIABLES] = {0};
    for (size_t i = 0; i < n_known; i++) {
        if (known[i] == 0 || known[i] >= FIRST_OUTPUT)
            return fail(c, "%sdirectional derivative: value reference %.0f is no input or parameter", "",
                        known[i], 0);
        change[known[i]] += seed[i];
    }
    for (size_t i = 0; i < n_unknown; i++)
        if (unknown[i] < FIRST_OUTPUT || unknown[i] >= N_VARIABLES)
            return fail(c, "%sdirectional derivative: value reference %.0f is no output", "", unknown[i], 0);
    model_tangent(&c->state, c->data, c->state.mode < STEPPING, change);
    for (size_t i = 0; i < n_unknown; i++) result[i] = change[unknown[i]];
    return 0;
}

int core_terminate(Instance* c) {
    if (c->state.mode != STEPPING) return fail(c, "%sterminate before initialization", "", 0, 0);
    c->state.mode = TERMINATED;
    return 0;
}

static const char tag[] = MODEL_TOKEN;

size_t core_saved_size(void) { return sizeof tag + sizeof(State); }

void core_save(const Instance* c, char* bytes) {
    memcpy(bytes, tag, sizeof tag);
    memcpy(bytes + sizeof tag, &c->state, sizeof(State));
}

int core_restore(Instance* c, const char* bytes, size_t size) {
    if (size != core_saved_size())
        return fail(c, "%ssaved state has %.0f bytes, expected %.0f", "", (double)size, (double)core_saved_size());
    if (memcmp(bytes, tag, sizeof tag) != 0)
        return fail(c, "%ssaved state belongs to another FMU or another version of this one", "", 0, 0);
    memcpy(&c->state, bytes + sizeof tag, sizeof(State));
    return 0;
}
