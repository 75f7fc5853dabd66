/* A CasADi component as a model, in two files: kernels_NAME.c has the kernels and, from here, the
 * code around them; part_NAME.c has the tables and, from here, what joins them to that code. Kernels
 * know no name and no number of a vehicle, so they are compiled once for many.
 *
 * Included at the end of both. A kernel reads its arguments while it writes its results, so the two
 * never share a buffer.
 */
#define JOINED(FUNCTION, NAME) FUNCTION##_of_##NAME
#define EXPANDED(FUNCTION, NAME) JOINED(FUNCTION, NAME)
#define NAMED(FUNCTION) EXPANDED(FUNCTION, PART)

void NAMED(prepare)(const Part* p, double* prepared);
void NAMED(initial)(const Part* p, double* x);
void NAMED(step)(const Part* p, double h, double* x_next);
void NAMED(outputs)(Part* p);
void NAMED(tangent)(const Part* p, int starting, const double* noise, double* change);
#ifdef EXCHANGED
int NAMED(rests)(const Part* p);
#endif
#ifdef SAMPLED
void NAMED(update)(const Part* p, const double* noise, const double* delayed, double* x_next);
#if N_NOISE > 0
void NAMED(sizes)(const Part* p, double* sizes);
#endif
#if N_LINES > 0
void NAMED(signals)(const Part* p, double* now);
void NAMED(delays)(const Part* p, double* seconds);
#endif
#endif

#ifdef KERNELS
#define PARAMETERS (p->v + 1)
#define KNOWN PARAMETERS, p->prepared /* parameters, and what was computed of them alone */
#define INPUTS (p->v + FIRST_INPUT)
#define OUTPUTS (p->v + FIRST_OUTPUT)

/* Call a kernel: KERNEL, where its result goes, its arguments. Work space is on the stack. */
#define CALL(KERNEL, RESULT, ...)                       \
    do {                                                \
        const double* arg[N_ARGUMENTS] = {__VA_ARGS__}; \
        double* res[N_RESULTS] = {RESULT};              \
        int iw[N_INTEGERS];                             \
        double w[N_WORK];                               \
        KERNEL(arg, res, iw, w, 0);                     \
    } while (0)

void NAMED(prepare)(const Part* p, double* prepared) { CALL(prepare, prepared, PARAMETERS); }

void NAMED(initial)(const Part* p, double* x) { CALL(initial, x, INPUTS, PARAMETERS); }

/* STEP_SHORTCUTS(TRY) stands for TRY(0) TRY(1) ..., a cheaper kernel of the same numbers each, which
 * is taken if it holds over the next H seconds; likewise of the other kernels. Calls by name: through a table of kernels a step takes
 * 8 % longer. */
#define IF_HOLDS(I, H, KERNEL, RESULT, ...)                \
    do {                                                   \
        double holds;                                      \
        const double ahead = H;                            \
        CALL(holds_##I, &holds, p->x, KNOWN, &ahead);      \
        if (holds) {                                       \
            CALL(KERNEL##_##I, RESULT, __VA_ARGS__);       \
            return;                                        \
        }                                                  \
    } while (0);

void NAMED(step)(const Part* p, double h, double* x_next) {
#define TRY(I) IF_HOLDS(I, h, cheap_step, x_next, p->x, INPUTS, KNOWN, &h)
    STEP_SHORTCUTS(TRY)
#undef TRY
    CALL(step, x_next, p->x, INPUTS, KNOWN, &h);
}

void NAMED(outputs)(Part* p) {
#define TRY(I) IF_HOLDS(I, 0, cheap_outputs, OUTPUTS, p->x, INPUTS, KNOWN)
    OUTPUTS_SHORTCUTS(TRY)
#undef TRY
    CALL(outputs, OUTPUTS, p->x, INPUTS, KNOWN);
}

void NAMED(tangent)(const Part* p, int starting, const double* noise, double* change) {
    const double *d_p = change + 1, *d_u = change + FIRST_INPUT;
    double* d_y = change + FIRST_OUTPUT;
    if (starting) CALL(initial_tangent, d_y, INPUTS, PARAMETERS, d_u, d_p, noise);
#ifdef EXCHANGED
    else CALL(tangent, d_y, p->x, INPUTS, PARAMETERS, d_u, d_p, p->next);
#else
    else CALL(tangent, d_y, p->x, INPUTS, PARAMETERS, d_u, d_p);
#endif
}

#ifdef EXCHANGED
int NAMED(rests)(const Part* p) {
    double yes;
    CALL(rests, &yes, PARAMETERS);
    return yes != 0;
}
#endif

#ifdef SAMPLED
void NAMED(update)(const Part* p, const double* noise, const double* delayed, double* x_next) {
#define TRY(I) IF_HOLDS(I, 0, cheap_update, x_next, p->x, INPUTS, KNOWN, noise, delayed)
    UPDATE_SHORTCUTS(TRY)
#undef TRY
    CALL(update, x_next, p->x, INPUTS, KNOWN, noise, delayed);
}
#if N_NOISE > 0
void NAMED(sizes)(const Part* p, double* sizes) { CALL(noise_sizes, sizes, KNOWN); }
#endif
#if N_LINES > 0
void NAMED(signals)(const Part* p, double* now) {
#define TRY(I) IF_HOLDS(I, 0, cheap_signals, now, p->x, INPUTS, KNOWN)
    SIGNALS_SHORTCUTS(TRY)
#undef TRY
    CALL(signals, now, p->x, INPUTS, KNOWN);
}
void NAMED(delays)(const Part* p, double* seconds) { CALL(delays, seconds, KNOWN); }
#endif
#endif

#else
#ifdef SAMPLED
static const Sampling sampling = {
    .period = SAMPLE_PERIOD,
    .seed = SEED,
    .n_noise = N_NOISE,
#if N_NOISE > 0
    .sizes = NAMED(sizes),
#endif
    .stream = STREAM,
    .n_lines = N_LINES,
    .lines = lines,
#if N_LINES > 0
    .signals = NAMED(signals),
    .delays = NAMED(delays),
#endif
    .update = NAMED(update),
};
#define SAMPLING &sampling
#else
#define SAMPLING NULL
#endif

const Model MODEL = {
    .n_variables = N_VARIABLES,
    .first_input = FIRST_INPUT,
    .first_output = FIRST_OUTPUT,
    .variables = variables,
    .n_states = N_STATES,
    .state_names = state_names,
    .max_step = MAX_STEP,
    .n_prepared = N_PREPARED,
    .prepare = NAMED(prepare),
    .sampling = SAMPLING,
    .initial = NAMED(initial),
#if !STILL
    .step = NAMED(step),
#endif
    .outputs = NAMED(outputs),
    .tangent = NAMED(tangent),
#ifdef EXCHANGED
    .n_continuous = N_CONTINUOUS,
    .continuous = continuous,
    .n_crossings = N_CROSSINGS,
    .crossings = crossings,
    .rests = NAMED(rests),
#endif
};
#endif
