/* A CasADi component as a model, in two files: kernels_NAME.c has the kernels and, from here, the
 * code around them; part_NAME.c has the tables and, from here, what joins them to that code. Kernels
 * know no name and no number of a vehicle, so they are compiled once for many.
 *
 * Included at the end of both.
 */
#define JOINED(FUNCTION, NAME) FUNCTION##_of_##NAME
#define EXPANDED(FUNCTION, NAME) JOINED(FUNCTION, NAME)
#define NAMED(FUNCTION) EXPANDED(FUNCTION, PART)

void NAMED(prepare)(const Part* p, double* prepared);
void NAMED(initial)(const Part* p, double* x);
void NAMED(step)(Part* p, double h);
void NAMED(outputs)(Part* p);
void NAMED(tangent)(const Part* p, int starting, const double* noise, double* change);
#ifdef EXCHANGED
int NAMED(rests)(const Part* p);
#endif
#ifdef SAMPLED
void NAMED(update)(Part* p, const double* noise, const double* delayed);
#if N_NOISE > 0
void NAMED(sizes)(const Part* p, double* sizes);
#endif
#if N_LINES > 0
void NAMED(signals)(const Part* p, double* now);
void NAMED(delays)(const Part* p, double* seconds);
#endif
#endif

#ifdef KERNELS
#define PARAMETERS (p->v + LANES)
#define KNOWN PARAMETERS, p->prepared /* parameters, and what was computed of them alone */
#define INPUTS (p->v + FIRST_INPUT * LANES)
#define OUTPUTS (p->v + FIRST_OUTPUT * LANES)
/* H for all aircraft. */
#define LASTING(H) double ahead[LANES]; EACH_LANE ahead[lane] = H

void NAMED(prepare)(const Part* p, double* prepared) { prepare(PARAMETERS, prepared); }

void NAMED(initial)(const Part* p, double* x) { initial(INPUTS, PARAMETERS, x); }

/* STEP_SHORTCUTS(TRY) stands for TRY(0) TRY(1) ..., a cheaper kernel of the same numbers each, which
 * is taken if it holds over the next H seconds, of all aircraft; likewise of the other kernels. Calls
 * by name: through a table of kernels a step takes 8 % longer. */
#define IF_HOLDS(I, H, KERNEL, ...)                \
    do {                                           \
        double holds[LANES];                       \
        int some = 0;                              \
        LASTING(H);                                \
        holds_##I(p->x, KNOWN, ahead, holds);      \
        EACH_LANE some |= holds[lane] == 0;        \
        if (!some) {                               \
            KERNEL##_##I(__VA_ARGS__);             \
            return;                                \
        }                                          \
    } while (0);

void NAMED(step)(Part* p, double h) {
    LASTING(h);
#define TRY(I) IF_HOLDS(I, h, cheap_step, p->x, INPUTS, KNOWN, ahead, p->x)
    STEP_SHORTCUTS(TRY)
#undef TRY
    step(p->x, INPUTS, KNOWN, ahead, p->x);
}

void NAMED(outputs)(Part* p) {
#define TRY(I) IF_HOLDS(I, 0, cheap_outputs, p->x, INPUTS, KNOWN, OUTPUTS)
    OUTPUTS_SHORTCUTS(TRY)
#undef TRY
    outputs(p->x, INPUTS, KNOWN, OUTPUTS);
}

void NAMED(tangent)(const Part* p, int starting, const double* noise, double* change) {
#if LANES > 1
    (void)p, (void)starting, (void)noise, (void)change;
#else
    const double *d_p = change + 1, *d_u = change + FIRST_INPUT;
    double* d_y = change + FIRST_OUTPUT;
#if !STARTS_ALIKE
    if (starting) {
        initial_tangent(INPUTS, PARAMETERS, d_u, d_p, noise, d_y);
        return;
    }
#endif
    (void)starting, (void)noise;
#ifdef EXCHANGED
    tangent(p->x, INPUTS, PARAMETERS, d_u, d_p, p->d_x, d_y);
#else
    tangent(p->x, INPUTS, PARAMETERS, d_u, d_p, d_y);
#endif
#endif
}

#ifdef EXCHANGED
int NAMED(rests)(const Part* p) {
    double yes;
    rests(PARAMETERS, &yes);
    return yes != 0;
}
#endif

#ifdef SAMPLED
void NAMED(update)(Part* p, const double* noise, const double* delayed) {
#define TRY(I) IF_HOLDS(I, 0, cheap_update, p->x, INPUTS, KNOWN, noise, delayed, p->x)
    UPDATE_SHORTCUTS(TRY)
#undef TRY
    update(p->x, INPUTS, KNOWN, noise, delayed, p->x);
}
#if N_NOISE > 0
void NAMED(sizes)(const Part* p, double* sizes) { noise_sizes(KNOWN, sizes); }
#endif
#if N_LINES > 0
void NAMED(signals)(const Part* p, double* now) {
#define TRY(I) IF_HOLDS(I, 0, cheap_signals, p->x, INPUTS, KNOWN, now)
    SIGNALS_SHORTCUTS(TRY)
#undef TRY
    signals(p->x, INPUTS, KNOWN, now);
}
void NAMED(delays)(const Part* p, double* seconds) { delays(KNOWN, seconds); }
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
    .holds = HOLDS,
#ifdef EXCHANGED
    .n_continuous = N_CONTINUOUS,
    .continuous = continuous,
    .n_crossings = N_CROSSINGS,
    .crossings = crossings,
    .rests = NAMED(rests),
#endif
};
#endif
