"""Functions with identical bits on every platform, as CasADi expressions.

The C library's sin, exp or pow differ in the last bit between platforms, and so would two FMUs of
one component. The functions here use only + - * / sqrt and floor, which IEEE 754 rounds the same
way everywhere. `tests/twin/component/test_portable.py` measures their accuracy.
"""

from math import factorial

import casadi as ca

_QUARTER_TURN_HIGH = float.fromhex("0x1.921fb544p+0")
"""The first 33 bits of pi / 2: times an integer below 2^20 it is exact."""
_QUARTER_TURN_LOW = float.fromhex("0x1.0b4611a626331p-34")  # the rest of pi / 2, the next 53 bits
_SQUARINGS = 6  # exp(x) = exp(x / 2^6)^(2^6): the argument of the series is below 1/2
_TINY = 1e-150  # replaces a sine of 0 in a division; its square is no subnormal


def sine(x: ca.SX) -> ca.SX:
    """Sine of an angle in rad, to 2e-16 for |x| <= 1e4."""
    odd, even, quarter = _reduced(x)
    value = ca.if_else(quarter - 2 * ca.floor(quarter / 2) > 0.5, even, odd)
    return ca.if_else(quarter > 1.5, -value, value)


def cosine(x: ca.SX) -> ca.SX:
    """Cosine of an angle in rad, to 2e-16 for |x| <= 1e4."""
    odd, even, quarter = _reduced(x)
    value = ca.if_else(quarter - 2 * ca.floor(quarter / 2) > 0.5, odd, even)
    return ca.if_else(ca.logic_or(quarter == 1, quarter == 2), -value, value)


def angle(cos: ca.SX, sin: ca.SX) -> ca.SX:
    """Angle in (-pi, pi] of a point on the unit circle, to 1e-15.

    Three halvings, tan(a / 2) = tan(a) / (1 + sqrt(1 + tan^2 a)), then the series of the arc
    tangent.
    """
    safe = ca.if_else(ca.fabs(sin) < _TINY, _TINY, sin)
    t = ca.if_else(cos < 0, (1 - cos) / safe, sin / (1 + ca.fabs(cos)))
    for _ in range(3):
        t = t / (1 + ca.sqrt(1 + t * t))
    return 16 * t * _series(-t * t, [1 / k for k in range(1, 27, 2)])


def decay(x: ca.SX) -> ca.SX:
    """exp(-x) for x >= 0, to a relative 2e-14 up to x = 30; arguments above that count as 30."""
    part = -ca.fmin(x, 30.0) / 2**_SQUARINGS
    value = _series(part, [1 / factorial(k) for k in range(16)])
    for _ in range(_SQUARINGS):
        value = value * value
    return value


def binomial_power(x: ca.SX, exponent: float) -> ca.SX:
    """(1 + x)^exponent by the binomial series, to a relative 1e-14 for |x| <= 0.25."""
    coefficients = [1.0]
    for k in range(28):
        coefficients.append(coefficients[-1] * (exponent - k) / (k + 1))
    return _series(x, coefficients)


def _reduced(x: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX]:
    """Sine and cosine of the remainder after quarter turns, and their number modulo 4.

    Source: Cody & Waite, Software Manual for the Elementary Functions, 1980, ch. 8.
    """
    turns = ca.floor(x * (2 / 3.141592653589793) + 0.5)
    rest = (x - turns * _QUARTER_TURN_HIGH) - turns * _QUARTER_TURN_LOW
    square = -rest * rest
    odd = rest * _series(square, [1 / factorial(2 * k + 1) for k in range(10)])
    even = _series(square, [1 / factorial(2 * k) for k in range(10)])
    return odd, even, turns - 4 * ca.floor(turns / 4)


def _series(x: ca.SX, coefficients: list[float]) -> ca.SX:
    value = ca.SX(coefficients[-1])
    for c in coefficients[-2::-1]:
        value = c + x * value
    return value
