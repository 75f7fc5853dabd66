"""Counter-based noise: the k-th draw of a channel is a function of seed, channel and k.

Nothing has to be remembered but the counter, so a rolled-back simulation draws the same numbers
again, and Python and every FMU on every platform draw the same bits: the generator is integer
arithmetic and the transformation to a normal variate uses + - * / and sqrt alone.

Source: generator, Salmon, Moraes, Dror & Shaw, Parallel random numbers: as easy as 1, 2, 3, SC11
(Philox4x64-10, as in NumPy); normal quantile, Wichura, Algorithm AS 241, Applied Statistics 37
(1988), PPND16.
"""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
CHANNELS_PER_BLOCK = 4
"""One Philox block gives four 64-bit words."""

_A = (
    3.3871328727963666080,
    1.3314166789178437745e2,
    1.9715909503065514427e3,
    1.3731693765509461125e4,
    4.5921953931549871457e4,
    6.7265770927008700853e4,
    3.3430575583588128105e4,
    2.5090809287301226727e3,
)
_B = (
    1.0,
    4.2313330701600911252e1,
    6.8718700749205790830e2,
    5.3941960214247511077e3,
    2.1213794301586595867e4,
    3.9307895800092710610e4,
    2.8729085735721942674e4,
    5.2264952788528545610e3,
)
_C = (
    1.42343711074968357734,
    4.63033784615654529590,
    5.76949722146069140550,
    3.64784832476320460504,
    1.27045825245236838258,
    2.41780725177450611770e-1,
    2.27238449892691845833e-2,
    7.74545014278341407640e-4,
)
_D = (
    1.0,
    2.05319162663775882187,
    1.67638483018380384940,
    6.89767334985100004550e-1,
    1.48103976427480074590e-1,
    1.51986665636164571966e-2,
    5.47593808499534494600e-4,
    1.05075007164441684324e-9,
)
_E = (
    6.65790464350110377720,
    5.46378491116411436990,
    1.78482653991729133580,
    2.96560571828504891230e-1,
    2.65321895265761230930e-2,
    1.24266094738807843860e-3,
    2.71155556874348757815e-5,
    2.01033439929228813265e-7,
)
_F = (
    1.0,
    5.99832206555887937690e-1,
    1.36929880922735805310e-1,
    1.48753612908506148525e-2,
    7.86869131145613259100e-4,
    1.84631831751005468180e-5,
    1.42151175831644588870e-7,
    2.04426310338993978564e-15,
)
_LN2 = 0.6931471805599453


def normal(seed: int, stream: int, channels: int, first: int, count: int) -> Array:
    """Standard normal draws of a sensor.

    Args:
        seed: Any integer from 0 to 2^63 - 1.
        stream: Number of the sensor, below 2^32: sensors with one seed draw different numbers.
        channels: Channels of the sensor.
        first: Counter of the first draw, >= 0.
        count: Draws per channel.

    Returns:
        Shape (count, channels); row i belongs to counter `first + i`.
    """
    blocks = -(-channels // CHANNELS_PER_BLOCK)
    words = [_words(seed, (stream << 32) | block, first, count) for block in range(blocks)]
    return normal_of_bits(np.hstack(words)[:, :channels])


def _words(seed: int, second_key: int, first: int, count: int) -> NDArray[np.uint64]:
    # NumPy counts up before it draws, so counter k of ours is block k + 1 of the generator.
    generator = np.random.Philox(
        key=np.array([seed, second_key], dtype=np.uint64),
        counter=np.array([first, 0, 0, 0], dtype=np.uint64),
    )
    return np.asarray(generator.random_raw(CHANNELS_PER_BLOCK * count), np.uint64).reshape(
        count, CHANNELS_PER_BLOCK
    )


def normal_of_bits(bits: NDArray[np.uint64]) -> Array:
    """Standard normal variates of 64-bit words: the quantile of their upper 52 bits."""
    p = ((bits >> np.uint64(12)).astype(np.float64) + 0.5) * 2.0**-52
    q = p - 0.5
    central = 0.180625 - q * q
    middle = q * _rational(central, _A, _B)
    tail = np.where(q < 0, p, 1.0 - p)
    r = np.sqrt(-_log(tail))
    near = _rational(r - 1.6, _C, _D)
    far = _rational(r - 5.0, _E, _F)
    outer = np.where(r <= 5.0, near, far)
    return np.where(np.abs(q) <= 0.425, middle, np.where(q < 0, -outer, outer))


def _rational(x: Array, above: tuple[float, ...], below: tuple[float, ...]) -> Array:
    return _horner(x, above) / _horner(x, below)


def _horner(x: Array, coefficients: tuple[float, ...]) -> Array:
    value = np.full_like(x, coefficients[-1])
    for c in coefficients[-2::-1]:
        value = value * x + c
    return value


def _log(x: Array) -> Array:
    """Natural logarithm by + - * / alone: the platform's own differs in the last bit.

    log(m 2^e) = 2 atanh((m - 1) / (m + 1)) + e log 2 with m in [sqrt(1/2), sqrt(2)).
    """
    m, e = np.frexp(x)
    small = m < 0.7071067811865476
    m, e = np.where(small, 2.0 * m, m), e - small
    s = (m - 1.0) / (m + 1.0)
    series = np.full_like(x, 1.0 / 23.0)
    for k in range(21, 0, -2):
        series = series * (s * s) + 1.0 / k
    return 2.0 * s * series + e * _LN2
