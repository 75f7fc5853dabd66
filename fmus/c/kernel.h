/* What kernels are made of beside the operations of C. */
#ifndef UAVTWIN_KERNEL_H
#define UAVTWIN_KERNEL_H

#include <math.h>

/* How many aircraft are stepped at once: one by an FMU, several by `lanes.c`. What one has as a number, several have
 * as a number each, side by side, so that one operation is that of all of them: the same on each, to the bit. */
#ifndef LANES
#define LANES 1
#endif
/* Number I of the present aircraft, within EACH_LANE. */
#define AT(I) ((I) * LANES + lane)
#define FOR_LANES for (int lane = 0; lane < LANES; lane++)
/* The same, and none touches what is another's, which compilers take for leave to do all at once. */
#if LANES == 1
#define EACH_LANE FOR_LANES
#elif defined(__clang__)
#define EACH_LANE _Pragma("clang loop vectorize(assume_safety)") FOR_LANES
#else
#define EACH_LANE _Pragma("GCC ivdep") FOR_LANES
#endif

/* Functions of the library that compilers know for one number alone: lane by lane within a kernel that else is of all
 * lanes at once, so that the numbers are the library's. */
#if LANES > 1 && defined(__GNUC__) && !defined(__clang__)
#define LANE_BY_LANE static __attribute__((const, noinline, unused, simd("notinbranch"))) double
#define ONE(F) \
    LANE_BY_LANE lane_##F(double x) { return F(x); }
#define TWO(F) \
    LANE_BY_LANE lane_##F(double x, double y) { return F(x, y); }
ONE(exp) ONE(log) ONE(sin) ONE(cos) ONE(tan) ONE(asin) ONE(acos) ONE(atan) ONE(sinh) ONE(cosh) ONE(tanh)
TWO(atan2) TWO(fmod)
LANE_BY_LANE lane_pow(double x, double y) { return x == 1. ? 1. : pow(x, y); }
#define exp(X) lane_exp(X)
#define log(X) lane_log(X)
#define sin(X) lane_sin(X)
#define cos(X) lane_cos(X)
#define tan(X) lane_tan(X)
#define asin(X) lane_asin(X)
#define acos(X) lane_acos(X)
#define atan(X) lane_atan(X)
#define sinh(X) lane_sinh(X)
#define cosh(X) lane_cosh(X)
#define tanh(X) lane_tanh(X)
#define pow(X, Y) lane_pow(X, Y)
#define atan2(X, Y) lane_atan2(X, Y)
#define fmod(X, Y) lane_fmod(X, Y)
#endif

/* Base of a power that nothing feels but on a condition: 1 without it, of which a power costs nothing. In a kernel of
 * one aircraft compilers make the power itself wait for the condition. */
#define IF_FELT(CONDITION, BASE) (LANES > 1 && !(CONDITION) ? 1. : BASE)

/* In front of a kernel: compiled for AVX2 as well, which the loader takes where the processor has it. It needs
 * fewer instructions, and as no product is fused with a sum the numbers are the same, to the bit. */
#if LANES == 1 && defined(__x86_64__) && defined(__GLIBC__) && defined(__GNUC__) && !defined(__clang__)
#define OFTEN __attribute__((target_clones("avx2", "default")))
#else
#define OFTEN
#endif

/* In front of what no step calls. Derivatives are longer than what they are of, and GCC takes up to three quarters of
 * its time for them at -O3: the same bits, of which nobody has many to wait for. */
#if defined(__OPTIMIZE__) && defined(__GNUC__) && !defined(__clang__)
#define SELDOM __attribute__((optimize("O1", "fp-contract=off")))
#else
#define SELDOM
#endif

/* Two divisions or two square roots at once: a processor takes for two side by side as long as for one. The
 * numbers are those of one after the other, to the bit. */
#if LANES == 1 && defined(__SSE2__)
#include <emmintrin.h>

/* x = a / b, y = c / d */
static inline void quotients(double a, double b, double c, double d, double* x, double* y) {
    const __m128d both = _mm_div_pd(_mm_set_pd(c, a), _mm_set_pd(d, b));
    *x = _mm_cvtsd_f64(both);
    *y = _mm_cvtsd_f64(_mm_unpackhi_pd(both, both));
}

/* x = sqrt(a), y = sqrt(b) */
static inline void roots(double a, double b, double* x, double* y) {
    const __m128d both = _mm_sqrt_pd(_mm_set_pd(b, a));
    *x = _mm_cvtsd_f64(both);
    *y = _mm_cvtsd_f64(_mm_unpackhi_pd(both, both));
}

#else

static inline void quotients(double a, double b, double c, double d, double* x, double* y) {
    *x = a / b;
    *y = c / d;
}

static inline void roots(double a, double b, double* x, double* y) {
    *x = sqrt(a);
    *y = sqrt(b);
}

#endif
#endif
