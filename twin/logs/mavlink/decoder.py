"""MAVLink messages -> samples of a flight table; the only module with MAVLink's units and frames.

| column | from | units in it |
|---|---|---|
| acc, gyro, mag, baro_pa | HIGHRES_IMU, as in `fields_updated` | m/s^2, rad/s, gauss, hPa, us |
| acc, gyro, mag | SCALED_IMU, 2, 3; RAW_IMU of ArduPilot | mG, mrad/s, mgauss as integers |
| baro_pa | SCALED_PRESSURE | hPa |
| pos, vel, q | ODOMETRY in LOCAL_NED | velocity in NED or along the body, us |
| q | ATTITUDE_QUATERNION, ATTITUDE | ms |
| pos, vel | LOCAL_POSITION_NED | ms |
| pos, q | VICON_POSITION_ESTIMATE | us |
| cmd_i | ACTUATOR_OUTPUT_STATUS, SERVO_OUTPUT_RAW | 0..1 or pulses of so many us |
| rotor_i | DEBUG_FLOAT_ARRAY `rotor_rads`, ESC_TELEMETRY_* | rad/s; rpm without a time |
| vbat_v, ibat_a | BATTERY_STATUS, SYS_STATUS | mV, cA, without a time |
| phase | EXTENDED_SYS_STATE | landed or not, without a time |

Every stamp passes `StampGate` and every number `MavlinkDecoder._sound` before a message becomes a
sample. A message without a time gets the newest time of the aircraft's clock.
"""

import math
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from enum import Enum

import numpy as np

from ...errors import ModelError
from ...frames import from_euler, to_ned
from ...physics.sensors.table import SENSORS
from ...vehicle import GRAVITY_M_S2
from ..ardupilot.log import motor_channels
from ..columns import LIMITS, MAX_MOTORS, POS, QUAT, VEL, motor_columns
from ..px4.outputs import motor_functions
from .frames import AUTOPILOTS, GCS, MOTORS, Message, dialect

# -- samples ------------------------------------------------------------------------------------
#
# Samples of a flight table in MAVLink messages, and the priority of messages.

GROUPS: dict[str, tuple[str, ...]] = {
    **{s.signal: s.columns for s in SENSORS if s.messages},
    "pos": POS,
    "vel": VEL,
    "q": QUAT,
    "vbat_v": ("vbat_v",),
    "ibat_a": ("ibat_a",),
}
"""Columns that are sampled together, except for `cmd` and `rotor`: `columns_of`."""


def columns_of(group: str, width: int) -> tuple[str, ...]:
    """Columns of a signal with this number of values: those of motors depend on their number."""
    return GROUPS.get(group) or motor_columns(group, width)


LANDED = "landed"
"""Group of the land detector: its value is a member of MAV_LANDED_STATE."""
RANKS: tuple[str, ...] = (
    "HIGHRES_IMU",
    "ODOMETRY",
    "ATTITUDE_QUATERNION",
    "LOCAL_POSITION_NED",
    "ACTUATOR_OUTPUT_STATUS",
    "DEBUG_FLOAT_ARRAY",
    "BATTERY_STATUS",
    "SCALED_IMU",
    "RAW_IMU",
    "SCALED_IMU2",
    "SCALED_IMU3",
    "ATTITUDE",
    "VICON_POSITION_ESTIMATE",
    "SERVO_OUTPUT_RAW",
    "ESC_TELEMETRY",
    "SCALED_PRESSURE",
    "SYS_STATUS",
    "EXTENDED_SYS_STATE",
)
"""Sources of samples, those with the least loss of precision first."""
_OFTEN = 1.5
"""Ratio of rates from which a faster source is preferred to one of a better rank."""


@dataclass(frozen=True, slots=True)
class Sample:
    """One reading of one signal.

    Attributes:
        group: A key of `GROUPS`, `cmd`, `rotor` or `LANDED`.
        source: Kind of message, a member of `RANKS`.
        t_us: Time of sampling, on the aircraft's clock, us.
        values: Values in the units of the flight table, in the order of its columns.
    """

    group: str
    source: str
    t_us: int
    values: tuple[float, ...]


class Sources:
    """Selected message of each signal, by the same rule in a file and in live flight.

    Attributes:
        chosen: Source of each group, after `choose` was called.
    """

    def __init__(self) -> None:
        self.chosen: dict[str, str] = {}
        self._heard: defaultdict[str, Counter[str]] = defaultdict(Counter)

    def add(self, sample: Sample) -> None:
        """Count a sample."""
        self._heard[sample.group][sample.source] += 1

    def choose(self) -> None:
        """Choose a source for each group that has none yet, from the counts so far: the one of the
        best rank among the frequent ones."""
        for group, counts in self._heard.items():
            if group not in self.chosen:
                most = max(counts.values())
                often = [s for s, n in counts.items() if n * _OFTEN >= most]
                self.chosen[group] = min(often, key=RANKS.index)


# -- time stamps --------------------------------------------------------------------------------
#
# Selection of time stamps that belong to the clock of the aircraft.
#
# A stamp is compared with the newest one: from 1 s before it to 60 s after it belongs to the same
# clock. Others are strays: damaged, or of another clock. Strays that agree with each other and
# outnumber the rest are the clock after a restart.

LATEST_US = 2**53
"""Year 2255 in us since 1970: no clock of an aircraft, since boot or since 1970, is beyond it."""
_BACK_US, _AHEAD_US = 1_000_000, 60_000_000  # largest steps of one clock
_RESTART = 20
"""Excess of consistent strays over stamps of the clock from which it is a restart."""
_CONFIRMED = 5
"""Number of stamps of one clock after which it is accepted as that of the aircraft."""
_CONTRADICTED = 3
"""Excess of strays from which an unconfirmed clock is rejected: the first stamps were strays."""


class Stamp(Enum):
    """Classification of a stamp."""

    FINE = "of the clock"
    STRAY = "far from the clock"
    RESTART = "of a clock that restarted"
    MISLED = "of the clock; those before were strays"
    IMPOSSIBLE = "no time"


class StampGate:
    """Classifies stamps of one aircraft, in order of arrival.

    Attributes:
        newest_us: Newest time of the clock, us; None: no stamp so far.
        lead: Excess of consistent strays over stamps of the clock.
    """

    def __init__(self) -> None:
        self.newest_us: int | None = None
        self.lead = 0
        self._candidate_us = 0
        self._count = 0

    def near(self, t_us: int) -> bool:
        """Whether a time, us, is of the clock; False before the first stamp."""
        return self.newest_us is not None and _follows(t_us, self.newest_us)

    def add(self, t_us: int) -> Stamp:
        """Classify a stamp, us."""
        if not 0 <= t_us < LATEST_US:
            return Stamp.IMPOSSIBLE
        if self.newest_us is None or self.near(t_us):
            self.newest_us = t_us if self.newest_us is None else max(t_us, self.newest_us)
            self.lead = max(self.lead - 1, 0)
            self._count += 1
            return Stamp.FINE
        agrees = self.lead > 0 and _follows(t_us, self._candidate_us)
        self._candidate_us = max(t_us, self._candidate_us) if agrees else t_us
        self.lead = self.lead + 1 if agrees else 1
        misled = self._count < _CONFIRMED
        if self.lead < (_CONTRADICTED if misled else _RESTART):
            return Stamp.STRAY
        self.newest_us, self._count, self.lead = self._candidate_us, self.lead, 0
        return Stamp.MISLED if misled else Stamp.RESTART


def _follows(t_us: int, newest_us: int) -> bool:
    return -_BACK_US <= t_us - newest_us <= _AHEAD_US


# -- messages -----------------------------------------------------------------------------------

ROTOR_ARRAY = "rotor_rads"
"""Name of the DEBUG_FLOAT_ARRAY with rotor speeds, rad/s."""
T_PER_GAUSS = 1e-4  # T
PA_PER_HPA = 100.0  # Pa
_RPM = 2 * math.pi / 60  # rad/s
_PULSES_US = (1000.0, 2000.0)  # pulses of command 0 and 1 without parameters
_SERVOS = 16
"""Number of outputs in a SERVO_OUTPUT_RAW."""
_UNKNOWN_16 = 65535  # value of an unknown field
_MOST_PARAMETERS = 4096
"""Largest number of parameters that are stored; autopilots have up to some 2000."""
_MOST_REASONS = 200  # counted by name; limits memory with damaged names
_NO_ATTITUDE = (math.nan,) * 4  # for angles that are not finite
_FRAMES_B = (dialect.MAV_FRAME_BODY_NED, dialect.MAV_FRAME_BODY_FRD)
"""Frames of ODOMETRY with velocity in body axes."""
_PULSE_PARAMETERS = (  # PX4 up to 1.12, later, ArduPilot
    ("PWM_MIN", "PWM_MAX"),
    ("PWM_MAIN_MIN", "PWM_MAIN_MAX"),
    ("MOT_PWM_MIN", "MOT_PWM_MAX"),
)

Found = Iterator[Sample]


class MavlinkDecoder:
    """Samples of the messages of one system, in order of arrival.

    Attributes:
        motors: Number of motors; from the heartbeat where not given.
        autopilot: Name of the autopilot from the heartbeat; "" before the first.
        type: MAV_TYPE of the heartbeat; None before the first.
        kinds: Number of messages of each known kind.
        dropped: Number of dropped samples and values, by signal and reason.
        parameters: Finite values of PARAM_VALUE by name.
        stamp: Classification of the last message's stamp; None: it has none. After `RESTART` the
            samples returned belong to a clock that restarted; after `MISLED` all samples before
            them have stray stamps.
    """

    def __init__(self, motors: int | None = None) -> None:
        self.motors, self.autopilot = motors, ""
        self.type: int | None = None
        self.kinds: Counter[str] = Counter()
        self.dropped: Counter[tuple[str, str]] = Counter()
        self.parameters: dict[str, float] = {}
        self.stamp: Stamp | None = None
        self._gate = StampGate()
        self._held: list[list[Sample]] = []
        self._strays = 0
        self._fixed_motors = motors is not None
        self._rpm: dict[int, Sequence[float]] = {}

    @property
    def newest_us(self) -> int | None:
        """Newest time of the aircraft's clock, us; None: no stamp so far."""
        return self._gate.newest_us

    @property
    def strays(self) -> int:
        """Number of messages whose stamp is far from all others."""
        return self._strays + len(self._held)

    def is_near(self, t_us: int) -> bool:
        """Whether a time, us, is within a minute of the aircraft's clock."""
        return self._gate.near(t_us)

    def samples(self, message: Message) -> list[Sample]:
        """Samples of a message: finite, within limits, and of the aircraft's clock.

        Samples with stray stamps are buffered and returned when the clock is found to have
        restarted (`stamp`).
        """
        kind = message.get_type()
        self.stamp = None
        if kind not in _READ:
            self.kinds[kind if kind in _NAMES else _UNKNOWN] += 1
            return []
        self.kinds[kind] += 1
        found = [s for s in _READ[kind](self, message) if self._sound(s)]
        if self.stamp is None or (self.stamp is Stamp.FINE and not self._held):
            return found
        if self.stamp is Stamp.IMPOSSIBLE:
            self._drop("time", f"{kind} has a time after the year 2255")
            return []
        if self.stamp is Stamp.STRAY:
            if self._gate.lead == 1:
                self._forget_held()
            self._held.append(found)
            return []
        if self.stamp is Stamp.FINE:
            if not self._gate.lead:
                self._forget_held()
            return found
        before = [s for samples in self._held for s in samples]
        self._held = []
        return [*before, *found]

    def _forget_held(self) -> None:
        self._strays += len(self._held)
        self._held = []

    def _sound(self, sample: Sample) -> bool:
        """Whether a sample is valid; invalid ones are counted."""
        values, limit = sample.values, LIMITS.get(sample.group, math.inf)
        if not all(math.isfinite(v) for v in values):
            why = "a value is NaN or infinite"
        elif max(map(abs, values)) > limit:
            why = f"a value is beyond {limit:g} (SI)"
        elif sample.group == "q" and not _is_unit(values):
            why = "the quaternion has not norm 1"
        elif sample.group in ("baro", "rotor") and min(values) < 0.0:
            why = "a value is negative"
        else:
            return True
        self._drop(sample.group, why)
        return False

    def _drop(self, group: str, why: str) -> None:
        """Count a dropped sample, under a bounded number of reasons."""
        key = group, why
        if key not in self.dropped and len(self.dropped) >= _MOST_REASONS:
            key = "others", "of further kinds"
        self.dropped[key] += 1

    # -- times ------------------------------------------------------------------------------

    def _at(self, t_us: int) -> int:
        """Time of the aircraft, us, from that in a message."""
        self.stamp = self._gate.add(t_us)
        return t_us

    def _at_ms(self, message: Message) -> int:
        return self._at(1000 * int(message.time_boot_ms))

    def _at_32(self, t_us: int) -> int:
        """Time from its lower 32 bits, which wrap around every 71 minutes."""
        if self.newest_us is None:
            return self._at(t_us)
        ahead = (t_us - self.newest_us + 2**31) % 2**32 - 2**31
        return self._at(self.newest_us + ahead)

    # -- messages ---------------------------------------------------------------------------

    def _heartbeat(self, m: Message) -> Found:
        if m.type != GCS and m.get_srcComponent() in (0, dialect.MAV_COMP_ID_AUTOPILOT1):
            self.autopilot = AUTOPILOTS.get(m.autopilot, f"autopilot of kind {m.autopilot}")
            self.type = int(m.type)
            if not self._fixed_motors:
                self.motors = MOTORS.get(m.type)
        yield from ()

    def _parameter(self, m: Message) -> Found:
        name, value = m.param_id, float(m.param_value)
        whole = m.param_type not in (dialect.MAV_PARAM_TYPE_REAL32, dialect.MAV_PARAM_TYPE_REAL64)
        if whole and self.autopilot == "PX4":  # PX4 sends the bytes of the integer
            value = float(np.float32(value).view(np.int32))
        if not math.isfinite(value):
            self._drop("parameters", f"{name} is NaN or infinite"[:80])
        elif name in self.parameters or len(self.parameters) < _MOST_PARAMETERS:
            self.parameters[name] = value
        yield from ()

    def _highres_imu(self, m: Message) -> Found:
        t, there, kind = self._at(m.time_usec), m.fields_updated, "HIGHRES_IMU"
        if m.id:  # from a second IMU
            return
        if there & 0x7 == 0x7:
            yield Sample("acc", kind, t, (m.xacc, m.yacc, m.zacc))
        if there & 0x38 == 0x38:
            yield Sample("gyro", kind, t, (m.xgyro, m.ygyro, m.zgyro))
        if there & 0x1C0 == 0x1C0:
            yield Sample("mag", kind, t, _scaled((m.xmag, m.ymag, m.zmag), T_PER_GAUSS))
        if there & 0x200:
            yield Sample("baro", kind, t, (m.abs_pressure * PA_PER_HPA,))

    def _scaled_imu(self, m: Message) -> Found:
        return self._integers(m, self._at_ms(m))

    def _raw_imu(self, m: Message) -> Found:
        t = self._at(m.time_usec)
        if self.autopilot != "ArduPilot":
            self._drop("acc", "RAW_IMU says its units with ArduPilot alone")
            return iter(())
        return self._integers(m, t)

    def _integers(self, m: Message, t: int) -> Found:
        kind = m.get_type()
        yield Sample("acc", kind, t, _scaled((m.xacc, m.yacc, m.zacc), 1e-3 * GRAVITY_M_S2))
        yield Sample("gyro", kind, t, _scaled((m.xgyro, m.ygyro, m.zgyro), 1e-3))
        if m.xmag or m.ymag or m.zmag:
            yield Sample("mag", kind, t, _scaled((m.xmag, m.ymag, m.zmag), 1e-3 * T_PER_GAUSS))

    def _pressure(self, m: Message) -> Found:
        yield Sample("baro", "SCALED_PRESSURE", self._at_ms(m), (m.press_abs * PA_PER_HPA,))

    def _odometry(self, m: Message) -> Found:
        t, kind = self._at(m.time_usec), "ODOMETRY"
        if m.frame_id != dialect.MAV_FRAME_LOCAL_NED:
            self._drop("pos", f"ODOMETRY in frame {m.frame_id}, not LOCAL_NED")
            return
        position, q, velocity = (m.x, m.y, m.z), tuple(m.q), (m.vx, m.vy, m.vz)
        if _known(position):
            yield Sample("pos", kind, t, position)
        if _known(q):
            yield Sample("q", kind, t, q)
        if not _known(velocity):
            return
        if m.child_frame_id == dialect.MAV_FRAME_LOCAL_NED:
            yield Sample("vel", kind, t, velocity)
        elif m.child_frame_id in _FRAMES_B and _is_unit(q) and all(map(math.isfinite, velocity)):
            yield Sample("vel", kind, t, tuple(float(v) for v in to_ned(q, velocity)))
        elif m.child_frame_id in _FRAMES_B:
            self._drop("vel", "ODOMETRY's velocity along the body, without an attitude")
        else:
            self._drop("vel", f"ODOMETRY's velocity in frame {m.child_frame_id}")

    def _quaternion(self, m: Message) -> Found:
        yield Sample("q", "ATTITUDE_QUATERNION", self._at_ms(m), (m.q1, m.q2, m.q3, m.q4))

    def _attitude(self, m: Message) -> Found:
        yield Sample("q", "ATTITUDE", self._at_ms(m), _from_euler(m))

    def _local_position(self, m: Message) -> Found:
        t, kind = self._at_ms(m), "LOCAL_POSITION_NED"
        yield Sample("pos", kind, t, (m.x, m.y, m.z))
        yield Sample("vel", kind, t, (m.vx, m.vy, m.vz))

    def _vicon(self, m: Message) -> Found:
        t, kind = self._at(m.usec), "VICON_POSITION_ESTIMATE"
        yield Sample("pos", kind, t, (m.x, m.y, m.z))
        yield Sample("q", kind, t, _from_euler(m))

    def _actuators(self, m: Message) -> Found:
        t = self._at(m.time_usec)
        if self.motors is not None:
            yield self._commands("ACTUATOR_OUTPUT_STATUS", t, m.actuator[: self.motors])

    def _servos(self, m: Message) -> Found:
        t = self._at_32(m.time_usec)
        if self.motors is None or m.port:
            return
        outputs = self.motor_outputs or list(range(1, self.motors + 1))
        if max(outputs) <= _SERVOS:
            values = [getattr(m, f"servo{k}_raw") for k in outputs]
            yield self._commands("SERVO_OUTPUT_RAW", t, values)

    @property
    def motor_outputs(self) -> list[int]:
        """Output numbers of motors 1..n by SERVOn_FUNCTION of ArduPilot or PWM_MAIN_FUNCn of PX4;
        [] without these parameters."""
        outputs = motor_channels(self.parameters)
        if len(outputs) != self.motors:
            found = motor_functions(self.parameters, "PWM_MAIN").items()
            channel = {motor: c + 1 for (_, c), motor in found}
            outputs = [channel.get(k, 0) for k in range(1, (self.motors or 0) + 1)]
        return outputs if all(outputs) else []

    def _commands(self, kind: str, t: int, values: Sequence[float]) -> Sample:
        """Commands 0..1 of outputs; a pulse slightly outside its range is clipped."""
        if any(abs(v) > 1.5 for v in values):
            low, high = self.pulses_us
            values = [(v - low) / (high - low) for v in values]
        clipped = tuple(min(max(float(v), 0.0), 1.0) if v == v else math.nan for v in values)
        return Sample("cmd", kind, t, clipped)

    @property
    def pulses_us(self) -> tuple[float, float]:
        """Pulse widths of command 0 and 1, us: from parameters, else 1000 and 2000."""
        for names in _PULSE_PARAMETERS:
            low, high = (self.parameters.get(n, math.nan) for n in names)
            if 500.0 < low < high < 3000.0:
                return low, high
        return _PULSES_US

    def _rotors(self, m: Message) -> Found:
        t = self._at(m.time_usec)
        if m.name == ROTOR_ARRAY and self.motors is not None:
            yield Sample("rotor", "DEBUG_FLOAT_ARRAY", t, tuple(m.data[: self.motors]))

    def _esc(self, m: Message) -> Found:
        """Rotor speeds, four motors per message; a sample is complete when every motor has reported
        again."""
        first = int(m.get_type().split("_")[2])
        self._rpm[first] = m.rpm
        if self.motors is None or self.newest_us is None:
            return
        blocks = range(1, self.motors + 1, 4)
        if self.motors <= MAX_MOTORS and all(k in self._rpm for k in blocks):
            rpm = [r for k in blocks for r in self._rpm[k]][: self.motors]
            self._rpm.clear()
            yield Sample("rotor", "ESC_TELEMETRY", self.newest_us, _scaled(rpm, _RPM))

    def _battery(self, m: Message) -> Found:
        cells = [v for v in m.voltages if v != _UNKNOWN_16]
        cells += [v for v in m.voltages_ext if v not in (0, _UNKNOWN_16)]
        if not m.id:  # first battery only
            yield from self._power("BATTERY_STATUS", sum(cells), m.current_battery)

    def _status(self, m: Message) -> Found:
        millivolts = 0 if m.voltage_battery == _UNKNOWN_16 else m.voltage_battery
        return self._power("SYS_STATUS", millivolts, m.current_battery)

    def _power(self, kind: str, millivolts: float, centiamperes: float) -> Found:
        if self.newest_us is None:
            return
        if millivolts:
            yield Sample("vbat_v", kind, self.newest_us, (1e-3 * millivolts,))
        if centiamperes != -1:
            yield Sample("ibat_a", kind, self.newest_us, (1e-2 * centiamperes,))

    def _landed(self, m: Message) -> Found:
        if self.newest_us is not None and m.landed_state:
            yield Sample(LANDED, "EXTENDED_SYS_STATE", self.newest_us, (float(m.landed_state),))


_READ: dict[str, Callable[[MavlinkDecoder, Message], Found]] = {  # kinds of message that are read
    "HEARTBEAT": MavlinkDecoder._heartbeat,
    "PARAM_VALUE": MavlinkDecoder._parameter,
    "HIGHRES_IMU": MavlinkDecoder._highres_imu,
    "SCALED_IMU": MavlinkDecoder._scaled_imu,
    "SCALED_IMU2": MavlinkDecoder._scaled_imu,
    "SCALED_IMU3": MavlinkDecoder._scaled_imu,
    "RAW_IMU": MavlinkDecoder._raw_imu,
    "SCALED_PRESSURE": MavlinkDecoder._pressure,
    "ODOMETRY": MavlinkDecoder._odometry,
    "ATTITUDE_QUATERNION": MavlinkDecoder._quaternion,
    "ATTITUDE": MavlinkDecoder._attitude,
    "LOCAL_POSITION_NED": MavlinkDecoder._local_position,
    "VICON_POSITION_ESTIMATE": MavlinkDecoder._vicon,
    "ACTUATOR_OUTPUT_STATUS": MavlinkDecoder._actuators,
    "SERVO_OUTPUT_RAW": MavlinkDecoder._servos,
    "DEBUG_FLOAT_ARRAY": MavlinkDecoder._rotors,
    "ESC_TELEMETRY_1_TO_4": MavlinkDecoder._esc,
    "ESC_TELEMETRY_5_TO_8": MavlinkDecoder._esc,
    "ESC_TELEMETRY_9_TO_12": MavlinkDecoder._esc,
    "BATTERY_STATUS": MavlinkDecoder._battery,
    "SYS_STATUS": MavlinkDecoder._status,
    "EXTENDED_SYS_STATE": MavlinkDecoder._landed,
}
if unread := {m for s in SENSORS for m in s.messages} - _READ.keys():
    raise ModelError(f"no reader of the MAVLink messages {', '.join(sorted(unread))} of a sensor")
USED = frozenset(i for i, kind in dialect.mavlink_map.items() if kind.msgname in _READ)
"""Ids of the messages in use."""
_NAMES = frozenset(kind.msgname for kind in dialect.mavlink_map.values())
"""Names of the messages of the dialect."""
_UNKNOWN = "of unknown kind"  # name for other messages


def _scaled(values: Iterable[float], factor: float) -> tuple[float, ...]:
    return tuple(v * factor for v in values)


def _known(values: Iterable[float]) -> bool:
    """Whether values are present: NaN stands for a missing one."""
    return not any(v != v for v in values)


def _is_unit(q: Sequence[float]) -> bool:
    """Whether a quaternion has norm 1 within slightly more than the precision of float32."""
    return abs(math.hypot(*q) - 1.0) <= 0.1


def _from_euler(m: Message) -> tuple[float, ...]:
    if not all(map(math.isfinite, (m.roll, m.pitch, m.yaw))):
        return _NO_ATTITUDE
    return tuple(float(v) for v in from_euler(m.roll, m.pitch, m.yaw))
