"""Motor commands of a PX4 log: logged, or rebuilt at full rate and compared with the logged
ones."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from ..columns import MAX_MOTORS, MIN_MOTORS
from ..flight import Array
from ..motors import MotorCommands, MotorOutput, describe_outputs
from ..samples import interpolated
from ..stamps import mean_rate_hz
from .control import (
    Gyro,
    Mixer,
    RateGains,
    airframe_mixer,
    blocked_by,
    derivative,
    integrals,
    low_pass,
    mix,
    mixer_names,
    mixer_scale,
    notch,
    raw_times,
    resample,
)
from .imu import from_px4_interval
from .log import Px4Log, Topic
from .outputs import Outputs, logged_outputs

# -- rebuilt ------------------------------------------------------------------------------------

MATCH_GOAL_US = 10.0  # rms of rebuilt less logged pulse width, us; made up
MISS_US, MISS_LIMITED = 30.0, 0.01
"""Misfit from which rebuilt commands are not the flown ones: a foreign or adaptive controller,
other filters. 3 % of a range of 1000 us is the uncertainty of a motor's gain; no log was used to
choose them."""
_AXES = ("ROLL", "PITCH", "YAW")  # of parameters
_SETPOINT = ("roll", "pitch", "yaw", "thrust_body[2]")  # fields of vehicle_rates_setpoint
_MIXER_TOLERANCE_US = 5.0  # rms below which a mixer is the one that flew
_FEWEST_PAIRS = 5  # pairs of controls and outputs of one instant that identify the mixer
_PAIRED_US = 1000  # between outputs and the controls from which they were mixed
_VERSIONS = ((1, 11), (1, 12), (1, 13))  # PX4 releases whose controller is that of `control`
_LONGEST_GAP_S = 5.0  # gap of the gyroscope that a cubic bridges
_MOST_PER_SAMPLE = 400.0  # 8 kHz logged at 20 Hz
_MOST_BIAS_RAD_S = 1.0  # of a gyroscope; beyond is damage
_MOST_INTEGRAL = 10.0  # of a control of -1..1
_DAMAGED = 100.0  # rad/s; larger values and NaN come from damaged logs


@dataclass(frozen=True, slots=True)
class Match:
    """Agreement of rebuilt and logged pulse widths in flight.

    Attributes:
        rms_us: Rms difference per motor, us, shape (motors,).
        limited: Share of the logged samples in which a motor is at a limit in one and farther than
            `MISS_US` from it in the other.
        n: Number of logged samples compared.
    """

    rms_us: Array
    limited: float
    n: int

    @property
    def misses(self) -> str:
        """Why these are not the commands that were flown; "" where they may be."""
        if self.n and (worst := float(np.max(self.rms_us))) > MISS_US:
            return f"they miss the logged ones by up to {worst:.0f} us rms"
        if self.limited > MISS_LIMITED:
            return (
                f"in {100 * self.limited:.0f} % of the logged outputs a motor is at its limit in "
                f"one and not in the other"
            )
        return ""


class CannotRebuildError(Exception):
    """Reason why the commands of a log cannot be rebuilt; becomes a finding."""


def rebuild(log: Px4Log, outputs: Outputs) -> tuple[MotorCommands, Match]:
    """Run the rate controller and the mixer again.

    Args:
        log: The log.
        outputs: Logged pulse widths, used to check the result and to identify the mixer of an
            unknown airframe; they do not enter the commands.

    Raises:
        CannotRebuildError: The log lacks a necessary part, which the text names.
    """
    _check_options(log)
    if any(m.unit == "CAN" for m in outputs.motors):
        raise CannotRebuildError("the outputs are CAN values, whose resolution is not known here")
    gyro = _gyro(log)
    controls = _topic(log, "actuator_controls_0", *(f"control[{k}]" for k in range(4)))
    mixer = Mixer(
        _scale(log, outputs, controls),
        int(log.params.get("MC_AIRMODE", 0)),
        log.params.get("THR_MDL_FAC", 0.0),
    )
    t_s = raw_times(gyro)
    rates, acceleration = _filtered(log, gyro, t_s)
    setpoint = _setpoint(log, t_s)
    active, armed = _flying(log, t_s), _armed(log, t_s)
    control = _controls(log, t_s, rates, acceleration, setpoint, active & armed, mixer)
    ran = slice(None, None, max(round(gyro.raw_hz / gyro.rate_hz), 1))
    cmd = np.where(armed[ran, None], mix(control[ran], mixer), 0.0)
    t_us = np.round(t_s[ran] * 1e6).astype(np.int64) + _latency_us(outputs, controls)
    match = compare(outputs, t_us, cmd, _flying(log, outputs.topic.t_s))
    return MotorCommands(t_us, cmd), match


def compare(
    outputs: Outputs, t_us: NDArray[np.int64], cmd: Array, flying: NDArray[np.bool_]
) -> Match:
    """Agreement of logged and rebuilt pulse widths in flight: rms difference, us per motor."""
    inside = flying & np.isfinite(outputs.values).all(axis=1)
    inside &= (outputs.topic.t_us >= t_us[0]) & (outputs.topic.t_us <= t_us[-1])
    n_motors = cmd.shape[1]
    if not inside.any():
        return Match(np.full(n_motors, np.nan), 0.0, 0)
    at = outputs.topic.t_us[inside]
    rebuilt = interpolated(at, t_us, cmd)
    width = outputs.low + rebuilt * (outputs.high - outputs.low)
    logged = outputs.values[inside]
    residual = logged - np.floor(width)
    at_limit = [
        (np.abs(one - limit) < 1) & (np.abs(other - limit) > MISS_US)
        for one, other in ((logged, width), (width, logged))
        for limit in (outputs.low, outputs.high)
    ]
    limited = float(np.mean(np.any(at_limit, axis=(0, 2))))
    return Match(np.sqrt(np.mean(residual**2, axis=0)), limited, int(inside.sum()))


def _check_options(log: Px4Log) -> None:
    """Refuse options that are not supported."""
    release = log.release
    version = (release >> 24 & 0xFF, release >> 16 & 0xFF)
    if version not in _VERSIONS:
        raise CannotRebuildError(
            f"the rate controller of PX4 {version[0]}.{version[1]} is not known here"
        )
    for name, meaning in (
        ("IMU_GYRO_DYN_NF", "dynamic notch filters"),
        ("MOT_SLEW_MAX", "a limit on how fast outputs change"),
        ("MOT_ORDERING", "Betaflight's motor order"),
        ("SYS_CTRL_ALLOC", "control allocation instead of a mixer"),
        ("CBRK_RATE_CTRL", "the rate controller switched off"),
    ):
        if log.params.get(name, 0.0) != 0.0:
            raise CannotRebuildError(f"{name} is {log.params[name]:g}: {meaning}")
    needed = [f"MC_{axis}RATE_{gain}" for axis in _AXES for gain in "PID"]
    lacking = [n for n in (*needed, "IMU_GYRO_CUTOFF", "IMU_DGYRO_CUTOFF") if n not in log.params]
    if lacking:
        raise CannotRebuildError(f"parameters not in the log: {', '.join(lacking)}")
    moved = sorted(n for n in log.changed if n.startswith(("MC_", "IMU_GYRO", "IMU_DGYRO", "THR_")))
    if moved:
        log.note("warning", "cmd", f"{', '.join(moved)} changed in flight; the last value is used")


def _topic(log: Px4Log, name: str, *fields: str) -> Topic:
    """A topic that is necessary for rebuilding."""
    topic = log.topic(name, 0, *fields)
    if topic is None or len(topic.t_us) < 2:
        raise CannotRebuildError(f"{name} is not in the log")
    return topic


def _gyro(log: Px4Log) -> Gyro:
    """Logged gyro means, and the sample rates of the on-board filters."""
    topic = _topic(
        log, "sensor_combined", "gyro_rad[0]", "gyro_rad[1]", "gyro_rad[2]", "gyro_integral_dt"
    )
    # windows of a damaged log may overlap; those of a valid one never do
    room_s = np.diff(topic.t_s, prepend=-np.inf)
    window_s = np.minimum(from_px4_interval(topic.data["gyro_integral_dt"]) * 1e-6, room_s)
    status = log.topic("vehicle_imu_status", 0, "gyro_rate_hz")
    rates = topic.array("gyro_rad", 3)
    good = (np.abs(rates) < _DAMAGED).all(axis=1) & (window_s > 0.0) & (window_s < 0.05)
    if status is None or good.sum() < 10:
        raise CannotRebuildError("the rate of the gyro (vehicle_imu_status) is not in the log")
    rate_hz = float(np.median(status.data["gyro_rate_hz"]))
    raw_hz = float(np.median(status.data.get("gyro_raw_rate_hz", np.array([rate_hz]))))
    if not (50.0 <= rate_hz <= raw_hz * 1.01 <= 33000.0):
        raise CannotRebuildError(f"a gyro rate of {rate_hz:.0f} Hz makes no sense")
    _check_gaps(topic.t_s[good], raw_hz)
    # a driver that reads a FIFO publishes the mean of its samples, with the stamp of the last
    delay_s = 0.5 * (1.0 / rate_hz - 1.0 / raw_hz)
    return Gyro(topic.t_s[good], window_s[good], rates[good], raw_hz, rate_hz, delay_s)


def _check_gaps(end_s: Array, raw_hz: float) -> None:
    """Refuse gaps that are too long for a cubic."""
    steps_s = np.diff(end_s)
    if steps_s.max() > _LONGEST_GAP_S:
        raise CannotRebuildError(
            f"the gyro pauses for {steps_s.max():.3g} s after {end_s[np.argmax(steps_s)]:.2f} s"
        )
    if (end_s[-1] - end_s[0]) * raw_hz > _MOST_PER_SAMPLE * len(end_s):
        raise CannotRebuildError(
            f"the gyro was logged {len(end_s)} times in {end_s[-1] - end_s[0]:.3g} s, too seldom "
            f"for filters that ran at {raw_hz:.0f} Hz"
        )


def _filtered(log: Px4Log, gyro: Gyro, t_s: Array) -> tuple[Array, Array]:
    """Body rates and angular acceleration as filtered for the rate controller, (n, 3) each."""
    p = log.params
    rates = notch(
        resample(gyro, t_s),
        gyro.raw_hz,
        p.get("IMU_GYRO_NF_FREQ", 0.0),
        p.get("IMU_GYRO_NF_BW", 0.0),
    )
    rates = low_pass(rates, gyro.raw_hz, p["IMU_GYRO_CUTOFF"])
    acceleration = low_pass(derivative(rates, t_s), gyro.raw_hz, p["IMU_DGYRO_CUTOFF"])
    bias = log.topic("estimator_sensor_bias", 0, *(f"gyro_bias[{k}]" for k in range(3)))
    if bias is not None:
        fields = [f"gyro_bias[{k}]" for k in range(3)]
        bias = _sound(log, bias, _within(bias.columns(fields), _MOST_BIAS_RAD_S))
    if bias is not None:
        t_us = np.round(t_s * 1e6).astype(np.int64)
        rates = rates - np.column_stack([bias.at(t_us, f"gyro_bias[{k}]") for k in range(3)])
    return rates, acceleration


def _setpoint(log: Px4Log, t_s: Array) -> Array:
    """Roll, pitch, yaw rate setpoints (rad/s) and thrust (0..1) at every time, (n, 4).

    Linear between the logged samples: on board they change several times between two samples.
    """
    topic = _topic(log, "vehicle_rates_setpoint", *_SETPOINT)
    values = topic.columns(_SETPOINT) * (1.0, 1.0, 1.0, -1.0)
    good = _within(values, _DAMAGED)
    sound = _sound(log, topic, good)
    if sound is None or len(sound.t_us) < 2:
        raise CannotRebuildError("vehicle_rates_setpoint has no finite sample")
    return interpolated(t_s, sound.t_s, values[good])


def _armed(log: Px4Log, t_s: Array) -> NDArray[np.bool_]:
    """Whether the motors are armed, by the last logged sample."""
    topic = log.topic("actuator_armed", 0, "armed")
    return _held(topic, "armed", t_s) if topic is not None else np.ones(len(t_s), dtype=np.bool_)


def _flying(log: Px4Log, t_s: Array) -> NDArray[np.bool_]:
    """Whether the vehicle is off the ground, so that the integrators run."""
    topic = log.topic("vehicle_land_detected", 0, "landed")
    if topic is None:
        return np.ones(len(t_s), dtype=np.bool_)
    down = _held(topic, "landed", t_s)
    if topic.has("maybe_landed"):
        down |= _held(topic, "maybe_landed", t_s)
    return ~down


def _held(topic: Topic, name: str, t_s: Array) -> NDArray[np.bool_]:
    """A flag, constant from its last sample."""
    return topic.at(np.round(t_s * 1e6).astype(np.int64), name) > 0.5


def _gains(log: Px4Log) -> RateGains:
    """Gains per axis; K multiplies P, I and D."""
    p = log.params
    k = np.array([p.get(f"MC_{a}RATE_K", 1.0) for a in _AXES])

    def each(gain: str) -> Array:
        return np.array([p.get(f"MC_{a}RATE_{gain}", 0.0) for a in _AXES])

    limit = np.array([p.get(f"MC_{a}R_INT_LIM", 0.3) for a in "RPY"])
    return RateGains(k * each("P"), k * each("I"), k * each("D"), each("FF"), limit)


def _controls(
    log: Px4Log,
    t_s: Array,
    rates: Array,
    acceleration: Array,
    setpoint: Array,
    active: NDArray[np.bool_],
    mixer: Mixer,
) -> Array:
    """Roll, pitch, yaw and thrust controls, (n, 4).

    Saturation of the mixer stops the integrators; a first pass without it finds where.
    """
    gains = _gains(log)
    error = setpoint[:, :3] - rates
    steady = gains.p * error - gains.d * acceleration + gains.ff * setpoint[:, :3]
    anchors_s, anchors = _anchors(log)
    free = np.zeros((len(t_s), 3), dtype=np.bool_)
    blocked = (free, free)
    controls = np.zeros((len(t_s), 4))
    for _ in range(2):
        integral = integrals(t_s, error, gains, active, blocked, anchors_s, anchors)
        controls = np.column_stack([steady + integral, setpoint[:, 3]])
        blocked = blocked_by(mix(controls, mixer), mixer)
    if log.params.get("MC_BAT_SCALE_EN", 0.0):
        battery = log.topic("battery_status", 0, "scale")
        if battery is not None:
            scale = battery.at(np.round(t_s * 1e6).astype(np.int64), "scale")
            controls *= np.where(scale > 0.0, scale, 1.0)[:, None]
    return controls


def _anchors(log: Px4Log) -> tuple[Array, Array]:
    """Logged integrals: times, s, (m,), and values, (m, 3)."""
    fields = ("rollspeed_integ", "pitchspeed_integ", "yawspeed_integ")
    topic = log.topic("rate_ctrl_status", 0, *fields)
    if topic is None:
        log.note("info", "cmd", "no rate_ctrl_status in the log: the integrals start from zero")
        return np.zeros(0), np.zeros((0, 3))
    sound = _sound(log, topic, _within(topic.columns(fields), _MOST_INTEGRAL))
    if sound is None:
        return np.zeros(0), np.zeros((0, 3))
    return sound.t_s, sound.columns(fields)


def _within(values: Array, most: float) -> NDArray[np.bool_]:
    """Whether all parts of a sample are finite and below a bound, shape (n,)."""
    return np.asarray((np.abs(values) < most).all(axis=1))


def _sound(log: Px4Log, topic: Topic, good: NDArray[np.bool_]) -> Topic | None:
    """The valid samples of a topic; the others are counted; None where there are none."""
    message = "samples left out of the rebuilt commands, a value is NaN or absurd"
    log.note("error", topic.name, message, ~good)
    if not good.any():
        return None
    return replace(topic, t_us=topic.t_us[good], data={k: v[good] for k, v in topic.data.items()})


def _paired(outputs: Outputs, controls: Topic) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Indices of logged outputs and of the logged controls from which they were mixed."""
    published = controls.t_us
    index = np.searchsorted(published, outputs.topic.t_us, side="right") - 1
    age = outputs.topic.t_us - published[np.maximum(index, 0)]
    pair = np.flatnonzero((index >= 0) & (age < _PAIRED_US))
    return pair, index[pair]


def _latency_us(outputs: Outputs, controls: Topic) -> int:
    """Time from the gyro sample to the output computed from it, us."""
    pair, index = _paired(outputs, controls)
    if not controls.by_sample_time or len(pair) == 0:
        return 0
    return int(np.median(outputs.topic.t_us[pair] - controls.t_us[index]))


def _mixed(
    log: Px4Log, outputs: Outputs, controls: Topic, names: Sequence[str]
) -> tuple[Array, dict[str, Array]]:
    """Logged outputs, and those computed by mixers from logged controls of the same instant, us,
    shape (n, motors) each; of no mixer where the instants are too few."""
    pair, index = _paired(outputs, controls)
    control = controls.array("control", 4)[index]
    pair, control = pair[control[:, 3] > 0.1], control[control[:, 3] > 0.1]
    made = {}
    for name in names:
        if len(mixer_scale(name)) != outputs.values.shape[1] or len(pair) < _FEWEST_PAIRS:
            continue
        mixer = Mixer(
            mixer_scale(name),
            int(log.params.get("MC_AIRMODE", 0)),
            log.params.get("THR_MDL_FAC", 0.0),
        )
        width = outputs.low + mix(control, mixer) * (outputs.high - outputs.low)
        made[name] = np.floor(width)
    return outputs.values[pair], made


def flown_mixer(log: Px4Log, outputs: Outputs) -> tuple[str, float] | None:
    """The known mixer that maps the logged controls to the logged outputs, and its rms error in us;
    only where no two mixers give the same outputs.

    Returns:
        None: none or several do, there are too few instants, or the log has no controls.
    """
    try:
        controls = _topic(log, "actuator_controls_0", *(f"control[{k}]" for k in range(4)))
    except CannotRebuildError:
        return None
    logged, made = _mixed(log, outputs, controls, mixer_names(outputs.values.shape[1]))
    apart = np.isfinite(logged).all(axis=1)
    for one, other in combinations(made.values(), 2):
        apart &= np.abs(one - other).max(axis=1) > 2 * _MIXER_TOLERANCE_US
    if not made or apart.sum() < _FEWEST_PAIRS:
        return None
    off_us = {n: float(np.median(np.abs(logged - m).max(axis=1)[apart])) for n, m in made.items()}
    fit = [name for name, off in off_us.items() if off <= _MIXER_TOLERANCE_US]
    return (fit[0], off_us[fit[0]]) if len(fit) == 1 else None


def _scale(log: Px4Log, outputs: Outputs, controls: Topic) -> Array:
    """Mixer of the airframe, checked on logged controls and outputs of the same instant."""
    known = airframe_mixer(log.params.get("SYS_AUTOSTART", 0.0))
    names: Sequence[str] = [known] if known else mixer_names(outputs.values.shape[1])
    logged, made = _mixed(log, outputs, controls, names)
    off_us = {name: float(np.median(np.abs(logged - m))) for name, m in made.items()}
    best = min(off_us, key=lambda name: off_us[name], default=known or "")
    best_us = off_us.get(best, np.inf)
    airframe = f"SYS_AUTOSTART {log.params.get('SYS_AUTOSTART', 0.0):.0f}"
    if not best or (off_us and best_us > _MIXER_TOLERANCE_US):
        raise CannotRebuildError(
            f"no mixer known here turns the logged controls into the logged outputs ({airframe}, "
            f"best {best or 'none'}: {best_us:.0f} us)"
        )
    if not known:
        log.note("info", "cmd", f"{airframe} is not known; mixer {best} fits to {best_us:.1f} us")
    return mixer_scale(best)


# -- commands -----------------------------------------------------------------------------------

_ENOUGH_HZ = 100.0  # rate of logged commands that need no rebuilding
_BACKWARD = 0.01  # control below which a motor turns backward


def from_px4_commands(log: Px4Log, rebuild: bool | None) -> MotorCommands | None:
    """Motor commands of a log.

    Args:
        log: The log; findings are added to it.
        rebuild: Whether commands are rebuilt, as in `formats.ReadOptions`.
    """
    return _from_motors(log) or _from_outputs(log, rebuild)


def _from_motors(log: Px4Log) -> MotorCommands | None:
    """Commands from `actuator_motors` (PX4 1.13 and later): thrust of motor i is control[i - 1],
    converted to a command by the thrust curve of THR_MDL_FAC as in the output drivers.

    Source: PX4, lib/mixer_module/functions/FunctionMotors.hpp.
    """
    topic = log.topic("actuator_motors", 0, "control[0]", "control[1]", "control[2]")
    if topic is None:
        return None
    fields = [f"control[{k}]" for k in range(MAX_MOTORS) if topic.has(f"control[{k}]")]
    control = topic.columns(fields)
    used = [k for k in range(len(fields)) if np.nanmax(np.abs(control[:, k]), initial=0.0) > 0.0]
    if len(used) < MIN_MOTORS:
        log.note("warning", "cmd", f"actuator_motors has values for {len(used)} motors: not used")
        return None
    count = int(log.params.get("CA_ROTOR_COUNT", 0.0))
    if not MIN_MOTORS <= count <= len(fields):
        count = used[-1] + 1
    if idle := [str(k + 1) for k in range(count) if k not in used]:
        log.note("warning", "cmd", f"no value for motor {', '.join(idle)} of {count}: taken as 0")
    control = control[:, :count]
    stopped = np.isnan(control)
    alone = int(stopped[~stopped.all(axis=1)].sum())
    text = "values NaN in actuator_motors, while others have some, mean stopped: taken as 0"
    log.note("warning", "cmd", text, alone)
    text = "values NaN in actuator_motors mean stopped, taken as 0"
    log.note("info", "cmd", text, int(stopped.sum()) - alone)
    control = np.where(stopped, 0.0, control)
    if topic.has("reversible_flags") and topic.data["reversible_flags"].any():
        text = (
            "values of motors that turn backward (reversible_flags), which is not known: set to 0"
        )
        log.note("error", "cmd", text, control < -_BACKWARD)
    cmd = _through_curve(log, control)
    outputs = [
        MotorOutput(k + 1, f"actuator_motors control[{k}]", "", 0.0, 1.0, "number of the field")
        for k in range(count)
    ]
    rate = f"actuator_motors, {topic.rate_hz:.0f} Hz"
    found = MotorCommands(topic.t_us, cmd, {"commands": rate, "motors": describe_outputs(outputs)})
    return found.clipped(log, "actuator_motors")


def _through_curve(log: Px4Log, thrust: Array) -> Array:
    """Command for a thrust: thrust = f u^2 + (1 - f) u with f = THR_MDL_FAC."""
    factor = log.params.get("THR_MDL_FAC", 0.0)
    if not 0.0 < factor <= 1.0:
        return thrust
    log.note(
        "info",
        "cmd",
        f"actuator_motors is thrust; made a command by THR_MDL_FAC {factor:.3g}, as its drivers do",
    )
    half = (1.0 - factor) / (2.0 * factor)
    return np.asarray(np.sqrt(half**2 + np.maximum(thrust, 0.0) / factor) - half)


def _from_outputs(log: Px4Log, rebuild: bool | None) -> MotorCommands | None:
    """Commands from `actuator_outputs`, scaled by the PWM range."""
    outputs = logged_outputs(log)
    if outputs is None:
        neither = "neither actuator_motors nor actuator_outputs"
        why = "" if log.instances("actuator_outputs") else f": {neither}"
        log.note("warning", "cmd", f"no motor commands{why}")
        return None
    rate, facts = outputs.topic.rate_hz, dict[str, str]()
    if rebuild or (rebuild is None and rate < _ENOUGH_HZ):
        try:
            return _rebuilt(log, outputs, requested=bool(rebuild))
        except CannotRebuildError as why:
            log.note("warning", "cmd", f"not rebuilt at full rate: {why}")
            facts["commands_not_rebuilt"] = str(why)
    found = MotorCommands(outputs.topic.t_us, outputs.cmd, facts)
    found.note_slow(log, _ENOUGH_HZ)
    facts["commands"] = f"actuator_outputs, {rate:.0f} Hz"
    facts["motors"] = describe_outputs(outputs.motors)
    return found.clipped(log, "actuator_outputs")


def _rebuilt(log: Px4Log, outputs: Outputs, requested: bool) -> MotorCommands:
    """Commands rebuilt at full rate.

    Raises:
        CannotRebuildError: The log lacks a necessary part, or the rebuilt commands differ from the
            flown ones and were not requested.
    """
    commands, match = rebuild(log, outputs)
    worst = float(np.max(match.rms_us))
    each = ", ".join(f"{r:.1f}" for r in match.rms_us)
    text = f"rms {each} us of pulse width per motor, n = {match.n} logged outputs while flying"
    if match.n == 0:
        log.note("warning", "cmd", "rebuilt commands have no logged output in flight to check them")
    elif match.misses and not requested:
        raise CannotRebuildError(
            f"{match.misses}, so this is not the controller that flew, or not with its parameters "
            f"({text}); --rebuild-commands takes them all the same"
        )
    elif worst > MATCH_GOAL_US:
        log.note("warning", "cmd", f"rebuilt commands miss the logged ones by over 10 us: {text}")
    log.note(
        "info",
        "cmd",
        "rebuilt by running the rate controller again on gyro and setpoints; its integral starts "
        "from the logged one at every rate_ctrl_status; logged outputs only check the result",
    )
    facts = {
        "commands": f"rebuilt from gyro and rate setpoints, {mean_rate_hz(commands.t_us):.0f} Hz",
        "commands_match": text,
        "motors": describe_outputs(outputs.motors),
    }
    return MotorCommands(commands.t_us, commands.cmd, facts)
