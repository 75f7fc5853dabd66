/* Counter-based standard normal draws, the same bits as twin/noise.py on every platform.
 *
 * Generator: Philox4x64-10, Salmon et al., SC11. Normal quantile: Wichura, AS 241, PPND16, with a
 * logarithm of + - * / alone, since the libraries of platforms differ in the last bit.
 */
#ifndef UAVTWIN_NOISE_H
#define UAVTWIN_NOISE_H

#include <math.h>
#include <stdint.h>
#include <string.h>

#include "kernel.h"

static uint64_t high_product(uint64_t a, uint64_t b) {
    uint64_t a0 = a & 0xffffffffu, a1 = a >> 32, b0 = b & 0xffffffffu, b1 = b >> 32;
    uint64_t low = a0 * b0, middle = a1 * b0 + (low >> 32);
    uint64_t other = a0 * b1 + (middle & 0xffffffffu);
    return a1 * b1 + (middle >> 32) + (other >> 32);
}

/* Four words of each lane, one lane beside the other. */
static void philox(uint64_t counter, const double* seeds, uint64_t key, uint64_t* out) {
    EACH_LANE {
        uint64_t c0 = counter, c1 = 0, c2 = 0, c3 = 0, key0 = (uint64_t)seeds[lane], key1 = key;
        for (int round = 0; round < 10; round++) {
            const uint64_t m0 = 0xD2E7470EE14C6C93u, m1 = 0xCA5A826395121157u;
            uint64_t h0 = high_product(m0, c0), l0 = m0 * c0, h1 = high_product(m1, c2), l1 = m1 * c2;
            c0 = h1 ^ c1 ^ key0;
            c1 = l1;
            c2 = h0 ^ c3 ^ key1;
            c3 = l0;
            key0 += 0x9E3779B97F4A7C15u;
            key1 += 0xBB67AE8584CAA73Bu;
        }
        out[AT(0)] = c0, out[AT(1)] = c1, out[AT(2)] = c2, out[AT(3)] = c3;
    }
}

static double horner(double x, const double c[8]) {
    double value = c[7];
    for (int i = 6; i >= 0; i--) value = value * x + c[i];
    return value;
}

/* Of a positive number that is not subnormal. */
static double exact_log(double x) {
    uint64_t bits;
    memcpy(&bits, &x, sizeof bits);
    int e = (int)(bits >> 52) - 1022;
    bits = (bits & 0x000fffffffffffffu) | 0x3fe0000000000000u;
    double m;
    memcpy(&m, &bits, sizeof m);
    e = m < 0.7071067811865476 ? e - 1 : e;
    m = m < 0.7071067811865476 ? 2.0 * m : m;
    double s = (m - 1.0) / (m + 1.0), series = 1.0 / 23.0;
    for (int k = 21; k > 0; k -= 2) series = series * (s * s) + 1.0 / k;
    return 2.0 * s * series + e * 0.6931471805599453;
}

static const double A[8] = {3.3871328727963665, 133.14166789178438, 1971.5909503065513, 13731.69376550946, 45921.95393154987, 67265.7709270087, 33430.57558358813, 2509.0809287301227};
static const double B[8] = {1.0, 42.31333070160091, 687.1870074920579, 5394.196021424751, 21213.794301586597, 39307.89580009271, 28729.085735721943, 5226.495278852854};
static const double C[8] = {1.4234371107496835, 4.630337846156546, 5.769497221460691, 3.6478483247632045, 1.2704582524523684, 0.2417807251774506, 0.022723844989269184, 0.0007745450142783414};
static const double D[8] = {1.0, 2.053191626637759, 1.6763848301838038, 0.6897673349851, 0.14810397642748008, 0.015198666563616457, 0.0005475938084995345, 1.0507500716444169e-09};
static const double E[8] = {6.657904643501103, 5.463784911164114, 1.7848265399172913, 0.29656057182850487, 0.026532189526576124, 0.0012426609473880784, 2.7115555687434876e-05, 2.0103343992922881e-07};
static const double F[8] = {1.0, 0.599832206555888, 0.1369298809227358, 0.014875361290850615, 0.0007868691311456133, 1.8463183175100548e-05, 1.421511758316446e-07, 2.0442631033899397e-15};

/* Replaces those of `draws`, one of each lane, that are not 0. What few need is left out where none does. */
static void quantiles(const uint64_t* bits, double* draws) {
    double p[LANES], q[LANES], r[LANES], drawn[LANES];
    int outer = 0, far = 0;
    EACH_LANE {
        p[lane] = ((double)(bits[lane] >> 12) + 0.5) * 2.220446049250313e-16;
        q[lane] = p[lane] - 0.5;
        outer |= fabs(q[lane]) > 0.425;
    }
    EACH_LANE {
        const double x = 0.180625 - q[lane] * q[lane];
        drawn[lane] = q[lane] * (horner(x, A) / horner(x, B));
    }
    if (outer) {
        EACH_LANE {
            r[lane] = sqrt(-exact_log(q[lane] < 0 ? p[lane] : 1.0 - p[lane]));
            const double value = horner(r[lane] - 1.6, C) / horner(r[lane] - 1.6, D);
            drawn[lane] = fabs(q[lane]) > 0.425 ? (q[lane] < 0 ? -value : value) : drawn[lane];
            far |= r[lane] > 5.0;
        }
    }
    if (far) {
        FOR_LANES {
            const double value = horner(r[lane] - 5.0, E) / horner(r[lane] - 5.0, F);
            if (r[lane] > 5.0) drawn[lane] = q[lane] < 0 ? -value : value;
        }
    }
    EACH_LANE draws[lane] = draws[lane] == 0.0 ? 0.0 : drawn[lane];
}

/* Replaces those of the n `draws` of each lane that are not 0 by draw i of counter k; `stream` tells
 * sensors with one seed apart. */
static void standard_normal(const double* seeds, uint64_t stream, int n, uint64_t k, double* draws) {
    uint64_t words[4 * LANES];
    for (int i = 0, drawn = -1; i < n; i++, draws += LANES) {
        int wanted = 0;
        EACH_LANE wanted |= draws[lane] != 0.0;
        if (!wanted) continue;
        if (i / 4 != drawn) philox(k + 1, seeds, (stream << 32) | (uint64_t)(drawn = i / 4), words);
        quantiles(words + i % 4 * LANES, draws);
    }
}

#endif
