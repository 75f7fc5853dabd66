/* What kernels are made of beside the operations of C. */
#ifndef UAVTWIN_KERNEL_H
#define UAVTWIN_KERNEL_H

#include <math.h>

/* In front of a kernel: compiled for AVX2 as well, which the loader takes where the processor has it. It needs
 * fewer instructions, and as no product is fused with a sum the numbers are the same, to the bit. */
#if defined(__x86_64__) && defined(__GLIBC__) && defined(__GNUC__) && !defined(__clang__)
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
#if defined(__SSE2__)
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
