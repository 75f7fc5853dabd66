/* A CasADi component as a model: the code around its kernels.
 *
 * Included at the end of part_NAME.c, which holds the tables and the kernels. A kernel reads its
 * arguments while it writes its results, so the two never share a buffer.
 */
#define PARAMETERS (p->v + 1)
#define INPUTS (p->v + FIRST_INPUT)
#define OUTPUTS (p->v + FIRST_OUTPUT)

/* Call a kernel: KERNEL, where its result goes, its arguments. Work space is on the stack. */
#define CALL(KERNEL, RESULT, ...)                         \
    do {                                                  \
        const double* arg[N_ARGUMENTS] = {__VA_ARGS__};   \
        double* res[N_RESULTS] = {RESULT};                \
        int iw[N_INTEGERS];                               \
        double w[N_WORK];                                 \
        KERNEL(arg, res, iw, w, 0);                       \
    } while (0)

static void model_initial(const Part* p, double* x) { CALL(initial, x, INPUTS, PARAMETERS); }

/* SHORTCUTS(TRY) stands for TRY(0) TRY(1) ..., a cheaper kernel of the same numbers each. Calls by
 * name: through a table of kernels a step takes 8 % longer. */
static void model_step(const Part* p, double h, double* x_next) {
#define TRY(I)                                                      \
    CALL(holds_##I, &holds, p->x, PARAMETERS, &h);                  \
    if (holds) {                                                    \
        CALL(cheap_step_##I, x_next, p->x, INPUTS, PARAMETERS, &h); \
        return;                                                     \
    }
    double holds = 0;
    SHORTCUTS(TRY)
    (void)holds;
#undef TRY
    CALL(step, x_next, p->x, INPUTS, PARAMETERS, &h);
}

static void model_outputs(Part* p) {
#define TRY(I)                                                      \
    CALL(holds_##I, &holds, p->x, PARAMETERS, &now);                \
    if (holds) {                                                    \
        CALL(cheap_outputs_##I, OUTPUTS, p->x, INPUTS, PARAMETERS); \
        return;                                                     \
    }
    double holds = 0;
    const double now = 0;
    SHORTCUTS(TRY)
    (void)holds, (void)now;
#undef TRY
    CALL(outputs, OUTPUTS, p->x, INPUTS, PARAMETERS);
}

static void model_tangent(const Part* p, int starting, const double* noise, double* change) {
    const double *d_p = change + 1, *d_u = change + FIRST_INPUT;
    double* d_y = change + FIRST_OUTPUT;
    if (starting) CALL(initial_tangent, d_y, INPUTS, PARAMETERS, d_u, d_p, noise);
#ifdef N_CONTINUOUS
    else CALL(tangent, d_y, p->x, INPUTS, PARAMETERS, d_u, d_p, p->next);
#else
    else CALL(tangent, d_y, p->x, INPUTS, PARAMETERS, d_u, d_p);
#endif
}

#ifdef N_CONTINUOUS
static int model_rests(const Part* p) {
    double yes;
    CALL(rests, &yes, PARAMETERS);
    return yes != 0;
}
#endif

#ifdef SAMPLE_PERIOD
static void model_update(const Part* p, const double* noise, const double* delayed, double* x_next) {
#define TRY(I)                                                                         \
    CALL(holds_##I, &holds, p->x, PARAMETERS, &now);                                   \
    if (holds) {                                                                       \
        CALL(cheap_update_##I, x_next, p->x, INPUTS, PARAMETERS, noise, delayed);      \
        return;                                                                        \
    }
    double holds = 0;
    const double now = 0;
    SHORTCUTS(TRY)
    (void)holds, (void)now;
#undef TRY
    CALL(update, x_next, p->x, INPUTS, PARAMETERS, noise, delayed);
}
#if N_NOISE > 0
static void model_sizes(const Part* p, double* sizes) { CALL(noise_sizes, sizes, PARAMETERS); }
#else
#define model_sizes NULL
#endif
#if N_LINES > 0
static void model_signals(const Part* p, double* now) { CALL(signals, now, p->x, INPUTS, PARAMETERS); }
static void model_delays(const Part* p, double* seconds) { CALL(delays, seconds, PARAMETERS); }
#else
#define model_signals NULL
#define model_delays NULL
#endif
static const Sampling sampling = {
    .period = SAMPLE_PERIOD,
    .seed = SEED,
    .n_noise = N_NOISE,
    .sizes = model_sizes,
    .stream = STREAM,
    .n_lines = N_LINES,
    .lines = lines,
    .signals = model_signals,
    .delays = model_delays,
    .update = model_update,
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
    .sampling = SAMPLING,
    .initial = model_initial,
    .step = model_step,
    .outputs = model_outputs,
    .tangent = model_tangent,
#ifdef N_CONTINUOUS
    .n_continuous = N_CONTINUOUS,
    .continuous = continuous,
    .n_crossings = N_CROSSINGS,
    .crossings = crossings,
    .rests = model_rests,
#endif
};
