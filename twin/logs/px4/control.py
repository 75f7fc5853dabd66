"""PX4's rate controller and mixer, re-run on a log to get its motor commands at full rate.

A default PX4 log has the motor outputs at 10 Hz, but all inputs from which they are computed at
higher rates: gyro (some 160 Hz), rate setpoints (50 Hz), gains, mixer. The commands are computed
from these.

Source: PX4 v1.12, modules sensors/vehicle_angular_velocity, mc_rate_control and
lib/mixer/MultirotorMixer (BSD licence; written from the description of what they compute).
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import reduce

import numpy as np
import scipy
from numpy.typing import NDArray

from ...vehicle.layouts import FRAMES
from ..flight import Array

_I_FACTOR_RAD_S = np.radians(400.0)  # of RateControl: the integral grows less at high rates
_MIN_DT_S, _MAX_DT_S = 0.000125, 0.02  # bounds of the step in mc_rate_control
_YAW_CEILING = 1.15  # of the mixer: yaw may use 15 % more
_CLIPPED_LOW = 0.005  # command below which a motor is at its lower limit


@dataclass(frozen=True, slots=True)
class Gyro:
    """Logged gyro samples: means over windows that end at `end_s`.

    Attributes:
        end_s: End of each window, s, shape (n,), increasing.
        window_s: Length of each window, s, shape (n,); a gap follows where they do not touch.
        rates: Mean body rates, FRD, rad/s, shape (n, 3).
        raw_hz: Rate at which the low-pass filters run on board.
        rate_hz: Rate of the controller, `raw_hz` over an integer.
        delay_s: Additional delay of the mean after the middle of its window.
    """

    end_s: Array
    window_s: Array
    rates: Array
    raw_hz: float
    rate_hz: float
    delay_s: float


@dataclass(frozen=True, slots=True)
class RateGains:
    """Gains of the rate controller, per axis roll, pitch, yaw, each of shape (3,)."""

    p: Array
    i: Array
    d: Array
    ff: Array
    limit: Array


@dataclass(frozen=True, slots=True)
class Mixer:
    """Multirotor mixer.

    Attributes:
        scale: Share of roll, pitch, yaw and thrust in each motor, shape (motors, 4).
        airmode: 0 off, 1 roll and pitch, 2 roll, pitch and yaw (MC_AIRMODE).
        thrust_factor: THR_MDL_FAC, 0..1.
    """

    scale: Array
    airmode: int
    thrust_factor: float


def raw_times(gyro: Gyro) -> Array:
    """Times of the filters' samples: the ends of the windows and equal steps between, s."""
    steps = np.maximum(np.round(np.diff(gyro.end_s) * gyro.raw_hz), 1).astype(np.int64)
    index = np.concatenate([[0], np.cumsum(steps)])
    return np.interp(np.arange(index[-1] + 1), index, gyro.end_s)


def resample(gyro: Gyro, t_s: Array) -> Array:
    """Body rates at any time from means over windows.

    The angle turned in each window is preserved: the rate is the slope of a cubic spline through
    the angle at the ends of the windows. Gaps are bridged by a cubic through the values in the
    middle of the windows.

    Args:
        gyro: Logged means of the gyro.
        t_s: Times, s, shape (m,).

    Returns:
        Body rates, rad/s, shape (m, 3).
    """
    start, end = gyro.end_s - gyro.window_s, gyro.end_s
    middle = end - 0.5 * gyro.window_s
    bend = scipy.interpolate.CubicSpline(middle, gyro.rates).derivative(2)(middle)
    at_middle = gyro.rates - gyro.window_s[:, None] ** 2 / 24.0 * bend  # a mean is no point value
    bridge = scipy.interpolate.CubicSpline(middle, at_middle).antiderivative()
    touch = np.concatenate([[False], start[1:] - end[:-1] < 0.1 * gyro.window_s[1:]])
    begin = np.where(touch, np.concatenate([start[:1], end[:-1]]), start)
    turned = gyro.rates * (end - begin)[:, None]
    skipped = bridge(begin) - bridge(np.concatenate([begin[:1], end[:-1]]))
    angle_end = np.cumsum(turned + skipped, axis=0)
    knots = np.column_stack([begin, end]).ravel()
    angles = np.stack([angle_end - turned, angle_end], axis=1).reshape(-1, 3)
    new = np.concatenate([[True], np.diff(np.maximum.accumulate(knots)) > 1e-6])
    slope = scipy.interpolate.CubicSpline(knots[new], angles[new]).derivative()
    return np.asarray(slope(np.clip(t_s + gyro.delay_s, knots[0], end[-1])))


def low_pass(x: Array, rate_hz: float, cutoff_hz: float) -> Array:
    """Second-order Butterworth low-pass as PX4's LowPassFilter2p, settled on the first sample.

    Args:
        x: Samples, shape (n, k).
        rate_hz: Sample rate.
        cutoff_hz: Cutoff; not positive switches the filter off.
    """
    if cutoff_hz <= 0.0:
        return x
    tan = np.tan(np.pi * min(cutoff_hz / rate_hz, 0.49))
    middle = 2.0 * np.cos(np.pi / 4.0) * tan
    c = 1.0 + middle + tan * tan
    b = np.array([1.0, 2.0, 1.0]) * tan * tan / c
    a = np.array([1.0, 2.0 * (tan * tan - 1.0) / c, (1.0 - middle + tan * tan) / c])
    return np.asarray(scipy.signal.lfilter(b, a, x - x[0], axis=0) + x[0], dtype=np.float64)


def notch(x: Array, rate_hz: float, centre_hz: float, width_hz: float) -> Array:
    """Second-order notch as PX4's NotchFilter; a centre of 0 Hz switches it off."""
    if centre_hz <= 0.0 or width_hz <= 0.0:
        return x
    alpha, beta = np.tan(np.pi * width_hz / rate_hz), -np.cos(2 * np.pi * centre_hz / rate_hz)
    b = np.array([1.0, 2.0 * beta, 1.0]) / (1.0 + alpha)
    a = np.array([1.0, b[1], (1.0 - alpha) / (1.0 + alpha)])
    return np.asarray(scipy.signal.lfilter(b, a, x - x[0], axis=0) + x[0], dtype=np.float64)


def derivative(x: Array, t_s: Array) -> Array:
    """Backward difference, shape of `x`, zero at the first sample."""
    return np.vstack([np.zeros((1, x.shape[1])), np.diff(x, axis=0) / np.diff(t_s)[:, None]])


def integrals(
    t_s: Array,
    error: Array,
    gains: RateGains,
    active: NDArray[np.bool_],
    blocked: tuple[NDArray[np.bool_], NDArray[np.bool_]],
    anchors_s: Array,
    anchors: Array,
) -> Array:
    """Integral part of the rate controller before each sample's own update.

    Between logged values (`rate_ctrl_status`, 5 Hz) the integral is run forward; at each logged
    value it starts again from that.

    Args:
        t_s: Times, s, shape (n,).
        error: Rate setpoint minus rate, rad/s, shape (n, 3).
        gains: Gains.
        active: Whether the integrator runs (armed and off the ground), shape (n,).
        blocked: Whether saturation blocks an increase, and a decrease, each of shape (n, 3).
        anchors_s: Times of the logged integrals, s, shape (m,).
        anchors: Logged integrals, shape (m, 3).
    """
    dt = np.clip(np.diff(t_s, prepend=t_s[0] - _MIN_DT_S), _MIN_DT_S, _MAX_DT_S)
    held = np.where(blocked[0], np.minimum(error, 0.0), error)
    held = np.where(blocked[1], np.maximum(held, 0.0), held)
    factor = np.maximum(1.0 - (held / _I_FACTOR_RAD_S) ** 2, 0.0)
    grown = np.cumsum(factor * gains.i * held * (dt * active)[:, None], axis=0)
    grown = np.vstack([np.zeros((1, 3)), grown[:-1]])
    if len(anchors_s) == 0:
        return np.asarray(np.clip(grown, -gains.limit, gains.limit))
    last = np.searchsorted(anchors_s, t_s, side="right") - 1
    at = np.minimum(np.searchsorted(t_s, anchors_s, side="left"), len(t_s) - 1)
    # a logged integral already includes the update of its own sample
    base = np.minimum(at + 1, len(t_s) - 1)
    value = np.where(
        (last >= 0)[:, None],
        anchors[np.maximum(last, 0)] + grown - grown[base][last],
        anchors[0] + grown - grown[at[0]],
    )
    return np.asarray(np.clip(value, -gains.limit, gains.limit))


def mix(controls: Array, mixer: Mixer) -> Array:
    """Roll, pitch, yaw and thrust controls -> motor commands 0..1, as PX4's MultirotorMixer.

    Args:
        controls: Roll, pitch, yaw -1..1 and thrust 0..1, shape (n, 4).
        mixer: Geometry and options.

    Returns:
        Commands, shape (n, motors).
    """
    limited = np.clip(controls, (-1.0, -1.0, -1.0, 0.0), 1.0)
    out = _AIRMODES.get(mixer.airmode, _airmode_off)(limited, mixer.scale)
    f = mixer.thrust_factor
    if f > 0.0:
        half = (1.0 - f) / (2.0 * f)
        out = -half + np.sqrt(half * half + np.maximum(out, 0.0) / f)
    return np.clip(out, 0.0, 1.0)


def blocked_by(cmd: Array, mixer: Mixer) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Whether a motor at its lower limit blocks an increase, and a decrease, of the integrators.

    Args:
        cmd: Commands, shape (n, motors).
        mixer: Geometry and options.

    Returns:
        Two masks for the next sample's roll, pitch and yaw, shape (n, 3).
    """
    if mixer.airmode == 2:
        none = np.zeros((len(cmd), 3), dtype=np.bool_)
        return none, none
    axes = np.array([mixer.airmode == 0, mixer.airmode == 0, True])
    low = np.vstack([np.zeros((1, cmd.shape[1])), cmd[:-1] < _CLIPPED_LOW])
    grow, shrink = (
        (low @ side.astype(np.float64)) > 0
        for side in (mixer.scale[:, :3] < 0.0, mixer.scale[:, :3] > 0.0)
    )
    return grow & axes, shrink & axes


def _gain(out: Array, way: Array, low: float, high: float) -> Array:
    """Step along `way` that removes the worst excess below `low` and above `high`, shape (n, 1)."""
    with np.errstate(divide="ignore", invalid="ignore"):
        excess = np.where(out < low, low - out, np.where(out > high, high - out, 0.0))
        k = np.where(np.abs(way) < 1e-7, 0.0, excess / way)
    none: Array = np.zeros(len(k))
    down, up = (reduce(worse, k.T, none) for worse in (np.minimum, np.maximum))
    return np.asarray((down + up)[:, None])


def _desaturate(
    out: Array, way: Array, low: float = 0.0, high: float = 1.0, reduce_only: bool = False
) -> Array:
    """Shift the outputs along `way` until they fit, or the excess is equal at both ends."""
    first = _gain(out, way, low, high)
    moved = out + first * way
    moved = moved + 0.5 * _gain(moved, way, low, high) * way
    return np.where(first > 0.0, out, moved) if reduce_only else moved


def _mix_yaw(out: Array, yaw: Array, scale: Array) -> Array:
    """Add yaw, reducing yaw rather than roll and pitch, and then thrust."""
    out = _desaturate(out + yaw[:, None] * scale[:, 2], scale[:, 2], 0.0, _YAW_CEILING)
    return _desaturate(out, scale[:, 3], reduce_only=True)


def _airmode_off(c: Array, scale: Array) -> Array:
    """Mix without increasing the thrust for authority."""
    out = c[:, [0, 1, 3]] @ scale[:, [0, 1, 3]].T
    out = _desaturate(out, scale[:, 3], reduce_only=True)
    out = _desaturate(_desaturate(out, scale[:, 0]), scale[:, 1])
    return _mix_yaw(out, c[:, 2], scale)


def _airmode_roll_pitch(c: Array, scale: Array) -> Array:
    """Mix with increased thrust for roll and pitch."""
    out = _desaturate(c[:, [0, 1, 3]] @ scale[:, [0, 1, 3]].T, scale[:, 3])
    return _mix_yaw(out, c[:, 2], scale)


def _airmode_all(c: Array, scale: Array) -> Array:
    """Mix with increased thrust for roll, pitch and yaw."""
    return _desaturate(_desaturate(c @ scale.T, scale[:, 3]), scale[:, 2])


_AIRMODES: dict[int, Callable[[Array, Array], Array]] = {  # MC_AIRMODE
    0: _airmode_off,
    1: _airmode_roll_pitch,
    2: _airmode_all,
}


# -- mixers -------------------------------------------------------------------------------------
#
# Multirotor geometries of PX4's mixers and the airframes that use them.

_MOMENT = 0.05  # of a rotor over its thrust, m; any value gives the same shares
_GEOMETRIES = {"quad_x": "x", "quad_wide": "wide", "quad_plus": "+", "hex_x": "hex x"}
"""Mixers whose commands are rebuilt, and the frame of each."""
_AIRFRAMES = {4001: "quad_x", 4010: "quad_x", 4011: "quad_x", 10016: "quad_wide"}
"""Mixer by SYS_AUTOSTART."""


def airframe_mixer(autostart: float) -> str | None:
    """Name of the mixer of a SYS_AUTOSTART airframe, None where it is not known."""
    return _AIRFRAMES.get(int(autostart))


def frame_of_mixer(name: str) -> str:
    """Frame of a known mixer, from `twin.vehicle.layouts.FRAMES`."""
    return _GEOMETRIES[name]


def mixer_names(motors: int) -> list[str]:
    """Known mixers for a number of motors."""
    return [name for name, of in _GEOMETRIES.items() if len(FRAMES[of][0]) == motors]


def mixer_scale(name: str) -> Array:
    """Share of roll, pitch, yaw and thrust in each motor of a known mixer, shape (motors, 4)."""
    forward, right, clockwise = np.array(FRAMES[_GEOMETRIES[name]][0]).T
    return geometry_scale(np.column_stack([forward, right, -clockwise]))


def geometry_scale(rotors: Array) -> Array:
    """Share of roll, pitch, yaw and thrust in each motor, shape (motors, 4).

    Pseudo-inverse of the map from rotor thrusts to moments and thrust, then normalised.

    Args:
        rotors: Position forward and right, direction (+1 counter-clockwise), shape (motors, 3).

    Source: PX4 v1.12, lib/mixer/MultirotorMixer/geometries/tools/px_generate_mixers.py.
    """
    x, y, turn = rotors.T
    effect = np.vstack([-y, x, _MOMENT * turn, np.ones(len(rotors))])
    scale = np.linalg.pinv(effect)
    size = np.linalg.norm(scale, axis=0)
    roll_pitch = max(size[0], size[1]) / np.sqrt(len(rotors) / 2.0)
    size = np.array([roll_pitch, roll_pitch, np.abs(scale[:, 2]).max(), scale[:, 3].mean()])
    return np.asarray(scale / size)
