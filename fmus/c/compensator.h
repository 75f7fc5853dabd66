/* A learned compensator as a model: a network that runs at the sample instants.
 *
 * Included at the end of part_NAME.c, which holds the tables and `network`, the C that emx-onnx-cgen
 * makes of an ONNX file. Inputs: virtual signals, commands, phase and, with N_GROUPS > 0, measured signals
 * and a truth value per sensor. Outputs: correction, corrected signals, spread, anomaly, inside, samples left out.
 *
 * States are those of the network, then what it put out, held until the next instant, then how many samples
 * were left out. The first instant is a period after the start; until then the correction is zero. So an
 * output never depends on an input within an instant, apart from a corrected signal on its own: corrected =
 * input + correction.
 *
 * A sample with an input that is no number is left out: the network does not run, and its state stays.
 */
#define SPREAD (N_NETWORK + N_CHANNELS) /* in the states, after the correction */
#define ANOMALY (SPREAD + N_CHANNELS)
#define INSIDE (ANOMALY + 1)
#define LEFT_OUT (INSIDE + 1)

/* The functions of the C library differ from platform to platform in the last bits, and are not compiled in
 * line. These are of float accuracy. exp: 2^n times a polynomial; Cephes, expf.c. */
static inline float network_exp(float x) {
    x = x > 88.0f ? 88.0f : x;
    x = x < -87.0f ? -87.0f : x;
    const float shift = 12582912.0f; /* 1.5 * 2^23: leaves no place for a fraction */
    const float n = (x * 1.44269504f + shift) - shift;
    const float r = (x - n * 0.693359375f) + n * 2.12194440e-4f;
    float y = 1.9875691500e-4f;
    y = y * r + 1.3981999507e-3f;
    y = y * r + 8.3334519073e-3f;
    y = y * r + 4.1665795894e-2f;
    y = y * r + 1.6666665459e-1f;
    y = y * r + 5.0000001201e-1f;
    y = (y * r) * r + r + 1.0f;
    const int32_t bits = ((int32_t)n + 127) * (1 << 23);
    float power;
    memcpy(&power, &bits, sizeof power);
    return y * power;
}

/* A quotient of polynomials; Eigen, GenericPacketMathFunctions.h, ptanh_float. */
static inline float network_tanh(float x) {
    x = x > 7.9f ? 7.9f : x;
    x = x < -7.9f ? -7.9f : x;
    const float s = x * x;
    float p = -2.76076847742355e-16f, q = 1.19825839466702e-06f;
    p = p * s + 2.00018790482477e-13f;
    p = p * s + -8.60467152213735e-11f;
    p = p * s + 5.12229709037114e-08f;
    p = p * s + 1.48572235717979e-05f;
    p = p * s + 6.37261928875436e-04f;
    p = p * s + 4.89352455891786e-03f;
    q = q * s + 1.18534705686654e-04f;
    q = q * s + 2.26843463243900e-03f;
    q = q * s + 4.89352518554385e-03f;
    return (p * x) / q;
}

/* The nearest whole number, the even one of two; of numbers below 2^22. */
static inline float network_round(float x) { return (x + 12582912.0f) - 12582912.0f; }
static inline float network_max(float a, float b) { return a > b ? a : b; }
static inline float network_min(float a, float b) { return a < b ? a : b; }

/* Whether processor and system keep registers of 256 bits: what is computed in them is the same to the last bit. */
#if defined(__x86_64__) && defined(__GNUC__)
#include <cpuid.h>
#include <immintrin.h>
#define WIDE __attribute__((target("avx2")))

static int has_avx2(void) {
    unsigned a, b, c, d, kept, high;
    if (!__get_cpuid(1, &a, &b, &c, &d) || !(c & bit_OSXSAVE)) return 0;
    __asm__("xgetbv" : "=a"(kept), "=d"(high) : "c"(0));
    return (kept & 6) == 6 && __get_cpuid_count(7, 0, &a, &b, &c, &d) && (b & bit_AVX2);
}

static int wide_registers(void) {
    static volatile int wide; /* 0: not asked yet; whoever asks finds the same */
    if (!wide) wide = has_avx2() ? 1 : -1;
    return wide > 0;
}
#endif

/* out = x w: x of `rows` rows of `depth` numbers, w of `depth` rows of `width`, read four rows at a time. Each sum runs
 * over the rows of w in order; of a single column it is the sum of eight sums. */
#if defined(__GNUC__)
typedef float Eight __attribute__((vector_size(32), aligned(4), may_alias));
#define EIGHT 8
#define LD(p) (*(const Eight*)(p))
#define ACROSS(s) (((s[0] + s[4]) + (s[2] + s[6])) + ((s[1] + s[5]) + (s[3] + s[7])))

#define PRODUCT(NAME, ATTRIBUTE)                                                                     \
    ATTRIBUTE static void NAME##_column(const float* x, const float* w, float* out, int rows, int depth) { \
        const int whole = depth - depth % EIGHT;                                                     \
        int row = 0, k;                                                                              \
        for (; row + 4 <= rows; row += 4, x += 4 * depth) {                                          \
            const float *x1 = x + depth, *x2 = x1 + depth, *x3 = x2 + depth;                         \
            Eight s = {0}, s1 = {0}, s2 = {0}, s3 = {0};                                             \
            for (k = 0; k < whole; k += EIGHT) {                                                     \
                const Eight u = LD(w + k);                                                           \
                s += LD(x + k) * u, s1 += LD(x1 + k) * u, s2 += LD(x2 + k) * u, s3 += LD(x3 + k) * u; \
            }                                                                                        \
            for (; k < depth; k++)                                                                   \
                s[0] += x[k] * w[k], s1[0] += x1[k] * w[k], s2[0] += x2[k] * w[k], s3[0] += x3[k] * w[k]; \
            out[row] = ACROSS(s), out[row + 1] = ACROSS(s1), out[row + 2] = ACROSS(s2), out[row + 3] = ACROSS(s3); \
        }                                                                                            \
        for (; row < rows; row++, x += depth) {                                                      \
            Eight s = {0};                                                                           \
            for (k = 0; k < whole; k += EIGHT) s += LD(x + k) * LD(w + k);                           \
            for (; k < depth; k++) s[0] += x[k] * w[k];                                              \
            out[row] = ACROSS(s);                                                                    \
        }                                                                                            \
    }                                                                                                \
    ATTRIBUTE static void NAME##_row(const float* x, const float* w, float* out, int depth, int width) { \
        int k = 0, i;                                                                                \
        memset(out, 0, (size_t)width * sizeof *out);                                                 \
        for (; k + 4 <= depth; k += 4, w += 4 * width) {                                             \
            const float *w1 = w + width, *w2 = w1 + width, *w3 = w2 + width;                         \
            for (i = 0; i + EIGHT <= width; i += EIGHT) {                                            \
                Eight s = LD(out + i) + x[k] * LD(w + i);                                            \
                s += x[k + 1] * LD(w1 + i);                                                          \
                s += x[k + 2] * LD(w2 + i);                                                          \
                s += x[k + 3] * LD(w3 + i);                                                          \
                *(Eight*)(out + i) = s;                                                              \
            }                                                                                        \
            for (; i < width; i++)                                                                   \
                out[i] = (((out[i] + x[k] * w[i]) + x[k + 1] * w1[i]) + x[k + 2] * w2[i]) + x[k + 3] * w3[i]; \
        }                                                                                            \
        for (; k < depth; k++, w += width)                                                           \
            for (i = 0; i < width; i++) out[i] += x[k] * w[i];                                       \
    }                                                                                                \
    static void NAME(const float* x, const float* w, float* out, int rows, int depth, int width) {   \
        if (width == 1) NAME##_column(x, w, out, rows, depth);                                       \
        else                                                                                         \
            for (int row = 0; row < rows; row++) NAME##_row(x + row * depth, w, out + row * width, depth, width); \
    }

#if defined(__x86_64__)
PRODUCT(product_wide, WIDE)
#endif
PRODUCT(product_narrow, )

static void network_product(const float* x, const float* w, float* out, int rows, int depth, int width) {
#if defined(__x86_64__)
    if (wide_registers()) {
        product_wide(x, w, out, rows, depth, width);
        return;
    }
#endif
    product_narrow(x, w, out, rows, depth, width);
}
#else
static void network_product(const float* x, const float* w, float* out, int rows, int depth, int width) {
    for (int row = 0; row < rows; row++)
        for (int column = 0; column < width; column++) {
            float sum = 0;
            for (int k = 0; k < depth; k++) sum += x[row * depth + k] * w[k * width + column];
            out[row * width + column] = sum;
        }
}
#endif

/* Largest of n numbers: of each of eight columns first, so that a compiler compares eight at once. */
static float network_largest(const float* x, int n) {
    float most[8], largest = x[0];
    int k = 0;
    for (int i = 0; i < 8; i++) most[i] = x[0];
    for (; k + 8 <= n; k += 8)
        for (int i = 0; i < 8; i++) most[i] = network_max(most[i], x[k + i]);
    for (; k < n; k++) largest = network_max(largest, x[k]);
    for (int i = 0; i < 8; i++) largest = network_max(largest, most[i]);
    return largest;
}

static void network_softmax(const float* x, float* out, int n) {
    const float largest = network_largest(x, n);
    float sums[8] = {0}, sum = 0;
    int k = 0;
    for (int i = 0; i < n; i++) out[i] = network_exp(x[i] - largest);
    for (; k + 8 <= n; k += 8)
        for (int i = 0; i < 8; i++) sums[i] += out[k + i];
    for (; k < n; k++) sum += out[k];
    for (int i = 0; i < 8; i++) sum += sums[i];
    for (int i = 0; i < n; i++) out[i] /= sum;
}

/* Numbers as 8-bit steps of `scale` from `zero` on, as ONNX defines DynamicQuantizeLinear; numbers that are all 0 are
 * steps of nothing. */
static void network_steps(const float* x, uint8_t* out, float* scale, uint8_t* zero, int n) {
    float low[8] = {0}, high[8] = {0}, least = 0, most = 0;
    int k = 0;
    for (; k + 8 <= n; k += 8)
        for (int i = 0; i < 8; i++) {
            low[i] = network_min(low[i], x[k + i]);
            high[i] = network_max(high[i], x[k + i]);
        }
    for (; k < n; k++) least = network_min(least, x[k]), most = network_max(most, x[k]);
    for (int i = 0; i < 8; i++) least = network_min(least, low[i]), most = network_max(most, high[i]);
    const float step = (most - least) / 255.0f, nothing = step > 0 ? network_round(-least / step) : 0.0f;
    for (int i = 0; i < n; i++) {
        const float place = network_round(step > 0 ? x[i] / step : 0.0f) + nothing;
        out[i] = (uint8_t)(int32_t)network_min(network_max(place, 0.0f), 255.0f);
    }
    *scale = step;
    *zero = (uint8_t)(int32_t)nothing;
}

/* out = w (x - zero): w of `rows` rows of `depth` weights of 8 bits, in integers, so that no register and no order
 * changes a bit; a sum too large for 32 bits wraps around, as ONNX has it. */
#define BLOCK 256
static void rows_narrow(const int16_t* x, const int8_t* w, int32_t* sums, int rows, int depth, int n) {
    for (int row = 0; row < rows; row++, w += depth) {
        int32_t sum = 0;
        for (int k = 0; k < n; k++) sum += x[k] * w[k];
        sums[row] = (int32_t)((uint32_t)sums[row] + (uint32_t)sum);
    }
}

#if defined(__x86_64__) && defined(__GNUC__)
/* Four rows at a time, of which sixteen products; the rest as above. */
WIDE static void rows_wide(const int16_t* x, const int8_t* w, int32_t* sums, int rows, int depth, int n) {
    const int whole = n - n % 16;
    int row = 0;
    for (; row + 4 <= rows; row += 4) {
        const int8_t* first = w + (size_t)row * (size_t)depth;
        __m256i s[4] = {_mm256_setzero_si256(), _mm256_setzero_si256(), _mm256_setzero_si256(), _mm256_setzero_si256()};
        for (int k = 0; k < whole; k += 16) {
            const __m256i u = _mm256_loadu_si256((const __m256i*)(x + k));
            for (int i = 0; i < 4; i++) {
                const __m128i weights = _mm_loadu_si128((const __m128i*)(first + i * depth + k));
                s[i] = _mm256_add_epi32(s[i], _mm256_madd_epi16(u, _mm256_cvtepi8_epi16(weights)));
            }
        }
        const __m256i pairs = _mm256_hadd_epi32(_mm256_hadd_epi32(s[0], s[1]), _mm256_hadd_epi32(s[2], s[3]));
        const __m128i four = _mm_add_epi32(_mm256_castsi256_si128(pairs), _mm256_extracti128_si256(pairs, 1));
        _mm_storeu_si128((__m128i*)(sums + row), _mm_add_epi32(_mm_loadu_si128((const __m128i*)(sums + row)), four));
    }
    rows_narrow(x + whole, w + whole, sums, row, depth, n - whole);
    rows_narrow(x, w + (size_t)row * (size_t)depth, sums + row, rows - row, depth, n);
}
#endif

static void network_rows(const int8_t* w, const uint8_t* x, int zero, int32_t* out, int rows, int depth) {
    memset(out, 0, (size_t)rows * sizeof *out);
    for (int first = 0; first < depth; first += BLOCK) {
        const int n = depth - first < BLOCK ? depth - first : BLOCK;
        int16_t block[BLOCK];
        for (int k = 0; k < n; k++) block[k] = (int16_t)(x[first + k] - zero);
#if defined(__x86_64__) && defined(__GNUC__)
        if (wide_registers()) {
            rows_wide(block, w + first, out, rows, depth, n);
            continue;
        }
#endif
        rows_narrow(block, w + first, out, rows, depth, n);
    }
}

static void model_initial(const Part* p, double* x) {
    static const double spread[N_CHANNELS] = INITIAL_SPREAD;
    (void)p;
    memset(x, 0, N_STATES * sizeof *x);
    memcpy(x + SPREAD, spread, sizeof spread);
}

static void narrowed(const double* from, float* to, int n) {
    for (int i = 0; i < n; i++) to[i] = (float)from[i];
}

static void widened(const float* from, double* to, int n) {
    for (int i = 0; i < n; i++) to[i] = from[i];
}

static int any_lacks(const float* values, int n) {
    for (int i = 0; i < n; i++)
        if (!isfinite(values[i])) return 1;
    return 0;
}

static void model_update(Part* p, const double* noise, const double* delayed) {
    static const unsigned char group[N_CHANNELS] = GROUP_OF_CHANNEL;
    const double* u = p->v + FIRST_INPUT;
    float signals[1][N_CHANNELS], command[1][N_COMMANDS], phase[1][1], measured[1][N_CHANNELS] = {{0}},
        valid[1][N_CHANNELS] = {{0}}, before[1][N_NETWORK], after[1][N_NETWORK], correction[1][N_CHANNELS],
        spread[1][N_CHANNELS], anomaly[1][1], inside[1][1];
    (void)noise, (void)delayed;
    narrowed(u, signals[0], N_CHANNELS);
    narrowed(u += N_CHANNELS, command[0], N_COMMANDS);
    narrowed(u += N_COMMANDS, phase[0], 1);
    if (N_GROUPS) {
        narrowed(u += 1, measured[0], N_CHANNELS);
        u += N_CHANNELS;
        for (int i = 0; i < N_CHANNELS; i++) {
            valid[0][i] = (float)u[group[i]];
            if (!(valid[0][i] > 0.5f)) measured[0][i] = 0; /* never looked at */
        }
    }
    if (any_lacks(signals[0], N_CHANNELS) || any_lacks(command[0], N_COMMANDS) || any_lacks(phase[0], 1) ||
        any_lacks(measured[0], N_CHANNELS)) {
        const double left_out = p->x[LEFT_OUT] + 1;
        double network_states[N_NETWORK];
        memcpy(network_states, p->x, sizeof network_states);
        model_initial(p, p->x);
        memcpy(p->x, network_states, sizeof network_states);
        p->x[LEFT_OUT] = left_out;
        return;
    }
    narrowed(p->x, before[0], N_NETWORK);
    network(signals, command, phase, measured, valid, before, correction, spread, anomaly, inside, after);
    widened(after[0], p->x, N_NETWORK);
    widened(correction[0], p->x + N_NETWORK, N_CHANNELS);
    widened(spread[0], p->x + SPREAD, N_CHANNELS);
    widened(anomaly[0], p->x + ANOMALY, 1);
    widened(inside[0], p->x + INSIDE, 1);
}

static void model_outputs(Part* p) {
    const double *u = p->v + FIRST_INPUT, *correction = p->x + N_NETWORK;
    double* y = p->v + FIRST_OUTPUT;
    for (int i = 0; i < N_CHANNELS; i++) {
        y[i] = correction[i];
        y[N_CHANNELS + i] = u[i] + correction[i];
        y[2 * N_CHANNELS + i] = p->x[SPREAD + i];
    }
    y[3 * N_CHANNELS] = p->x[ANOMALY];
    y[3 * N_CHANNELS + 1] = p->x[INSIDE];
    y[3 * N_CHANNELS + 2] = p->x[LEFT_OUT];
}

/* What is held does not change with the inputs, at the start neither. */
static void model_tangent(const Part* p, int starting, const double* noise, double* change) {
    (void)p, (void)starting, (void)noise;
    memset(change + FIRST_OUTPUT, 0, (N_VARIABLES - FIRST_OUTPUT) * sizeof *change);
    memcpy(change + FIRST_OUTPUT + N_CHANNELS, change + FIRST_INPUT, N_CHANNELS * sizeof *change);
}

static const Sampling sampling = {.period = SAMPLE_PERIOD, .first = 1, .update = model_update};

const Model MODEL = {
    .n_variables = N_VARIABLES,
    .first_input = FIRST_INPUT,
    .first_output = FIRST_OUTPUT,
    .variables = variables,
    .n_states = N_STATES,
    .state_names = state_names,
    .max_step = MAX_STEP,
    .sampling = &sampling,
    .initial = model_initial,
    .outputs = model_outputs,
    .tangent = model_tangent,
    .passes = 1,
};
