"""The twin that follows the aircraft message by message, and its publication as a second aircraft.

At each reading of the IMU the airframe is stepped to its time with the newest commands, in the
steps of the FMUs; at every horizon its state is set to the measured one, or an observer corrects it
continuously. Rotor states, which no sensor measures, are not corrected. `Publisher` sends it as
MAVLink, for ground stations.
"""

import contextlib
import time
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from queue import Empty, SimpleQueue

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from twin.component.along import BUILDING, EachRow
from twin.errors import TwinError
from twin.frames import AXES
from twin.logs.columns import ACC, GYRO, POS, QUAT, VEL
from twin.logs.mavlink.decoder import Sample, columns_of
from twin.logs.mavlink.encode import attitude, heartbeat, imu, local_position
from twin.logs.mavlink.frames import AUTOPILOT, Message, dialect, packed, parser
from twin.residuals.stream import Equations
from twin.residuals.teacher_forced import GRID_S
from twin.why.watch import Alarm

from ..sockets import Address, sending
from .status import sentence

Array = NDArray[np.float64]
_POSE = {
    "pos": POS,
    "vel": VEL,
    "q": QUAT,
    "gyro": tuple(f"omega_{a}" for a in AXES),
}
"""States of the airframe measured by each signal."""
_LONGEST_US = 500_000
"""Longest pause over which the twin is stepped; after a longer one its state is set to the measured
one."""


@dataclass(frozen=True, slots=True)
class Following:
    """Correction of the twin's state by the measured one.

    Attributes:
        horizon_s: Interval at which the state is set to the measured one, and free in between.
        observer_s: Time constant of an observer used instead, with which the deviation from the
            measured state decays: x += (1 - exp(-dt / observer)) (measured - x), a Luenberger
            observer of one gain; None: the state is set.
    """

    horizon_s: float
    observer_s: float | None = None

    def __str__(self) -> str:
        if self.observer_s is None:
            return f"set to the measured state every {self.horizon_s:g} s"
        return f"drawn to the measured state with a time constant of {self.observer_s:g} s"


@dataclass(frozen=True, slots=True)
class Reading:
    """Readings of the twin; SI, NED, FRD."""

    acc_b: Sequence[float]
    gyro_b: Sequence[float]
    position_n: Sequence[float]
    velocity_n: Sequence[float]
    q_nb: Sequence[float]
    omega_b: Sequence[float]


class FollowingTwin:
    """Airframe and IMU that follow an aircraft.

    Attributes:
        started: Whether it has a state: attitude, velocity and body rates were received, and
            commands.
    """

    def __init__(self, equations: Equations, following: Following) -> None:
        """Set up without measurements.

        Args:
            equations: Equations of the vehicle.
            following: Correction of its state.
        """
        body, sensor = equations.airframe, equations.imu
        self._p = body.parameter_values({"ground.enabled": 0.0})
        self._u = body.input_values()
        self._inputs = {name: i for i, name in enumerate(body.input_names)}
        names = [s.name for s in body.states]
        self._index = {g: [names.index(n) for n in states] for g, states in _POSE.items()}
        x, u = ca.SX.sym("x", len(names)), ca.SX.sym("u", len(self._u))
        self._windows = equations.windows
        outputs = body.outputs(x, u, self._p)
        place = {name: i for i, name in enumerate(body.output_names)}
        sensed = ca.vertcat(*[outputs[place[name]] for name in sensor.input_names])
        p = sensor.parameter_values()
        shown = sensor.outputs(sensor.initial(sensed, p), sensed, p)
        pose = ca.vertcat(*[x[self._index[g]] for g in ("pos", "vel", "q", "gyro")])
        self._read = EachRow(ca.Function("read", [x, u], [ca.vertcat(shown[:6], pose)]), 2)
        self._start = body
        self._x: Array | None = None
        self._measured: dict[str, tuple[float, ...]] = {}
        self._has_commands = False
        self._horizon_us = round(1e6 * following.horizon_s)
        self._observer_s = following.observer_s
        self._t_us = self._set_us = 0

    @property
    def started(self) -> bool:
        """Whether the twin has a state."""
        return self._x is not None

    def take(self, sample: Sample) -> bool:
        """Add a sample; returns whether the twin was stepped to its time."""
        if sample.group in self._index:
            self._measured[sample.group] = sample.values
        elif sample.group in ("cmd", "rotor", "vbat_v"):
            names = columns_of(sample.group, len(sample.values))
            for name, value in zip(names, sample.values, strict=True):
                if name in self._inputs:
                    self._u[self._inputs[name]] = value
                    self._has_commands |= sample.group != "vbat_v"
        if sample.group != "gyro" or not self._has_commands:
            return False
        if not {"q", "vel", "gyro"} <= set(self._measured):
            return False
        self._go_on(sample.t_us)
        return True

    def restart(self) -> None:
        """Reset state and measurements: another flight begins."""
        self._x, self._has_commands = None, False
        self._measured.clear()

    def read(self) -> Reading:
        """Present readings."""
        assert self._x is not None
        values = self._read(self._x[None], self._u[None])[0].tolist()
        edges = (0, 3, 6, 9, 12, 16, 19)
        return Reading(*(values[a:b] for a, b in pairwise(edges)))

    def _go_on(self, t_us: int) -> None:
        """Step to a time."""
        pause_us = t_us - self._t_us
        if (
            self._x is None
            or not 0 <= pause_us <= _LONGEST_US
            or not np.isfinite(self._x).all()  # its state diverged
        ):
            with BUILDING:
                start = self._start.initial(self._u, self._p)
                self._x = np.asarray(start, dtype=np.float64).ravel()
            self._set(t_us)
            return
        steps = round(1e-6 * pause_us / GRID_S)
        if steps:
            self._x = self._windows.after(self._x, np.tile(self._u, (steps, 1)))
        self._t_us += round(1e6 * GRID_S) * steps
        if self._observer_s is not None:
            self._draw(GRID_S * steps, self._observer_s)
        elif t_us - self._set_us >= self._horizon_us:
            self._set(t_us)

    def _set(self, t_us: int) -> None:
        """Set the state to the measured one."""
        x = np.array(self._x, dtype=np.float64).ravel()
        for group, values in self._measured.items():
            x[self._index[group]] = values
        self._x, self._t_us, self._set_us = x, t_us, t_us

    def _draw(self, over_s: float, observer_s: float) -> None:
        """Correct the state towards the measured one."""
        x = np.array(self._x, dtype=np.float64).ravel()
        pull = -np.expm1(-over_s / observer_s)
        for group, values in self._measured.items():
            index, measured = self._index[group], np.asarray(values)
            if group == "q" and x[index] @ measured < 0:
                measured = -measured
            x[index] += pull * (measured - x[index])
        q = self._index["q"]
        x[q] /= np.linalg.norm(x[q])
        self._x = x


DEFAULT_SYSTEM = 2
"""System id of the published twin."""
_EVERY_US = 20_000
"""Interval of published states, us: 50 Hz. Made up."""
_BEAT_S = 1.0
"""Interval of heartbeats, s, as MAVLink recommends."""
ANOMALY = "anomaly"
"""Name of the compensator's score."""
_TEXT, _NAME = 50, 10
"""Largest number of characters of a STATUSTEXT, and of a NAMED_VALUE_FLOAT."""
_AGES = 10_000
"""Number of ages for the 99th percentile. Made up."""


class Publisher:
    """Sender of the twin's readings.

    Attributes:
        system: Own system id.
        sent: Number of messages sent.
    """

    def __init__(self, to: Address, motors: int, system: int = DEFAULT_SYSTEM) -> None:
        """Open the connection.

        Raises:
            TwinError: There is no such host, or the system id is invalid.
        """
        if not 1 <= system <= 255:
            raise TwinError(f"system id {system} of the twin: 1 to 255.")
        self.system, self.sent = system, 0
        self._to, self._motors = to, motors
        self._socket = sending(to)
        self._packer = parser(system, AUTOPILOT)
        self._alarms: SimpleQueue[Alarm | float] = SimpleQueue()
        self._ages_s: deque[float] = deque(maxlen=_AGES)
        self._next_us, self._next_beat_s = 0, 0.0
        self._newest_us = 0

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()

    @property
    def age_p99_s(self) -> float:
        """99th percentile of the time from the arrival of an aircraft's message to the departure of
        the resulting one, s; NaN before any was sent."""
        return float(np.percentile(self._ages_s, 99)) if self._ages_s else float("nan")

    def alarm(self, alarm: Alarm) -> None:
        """Send an alarm with the next messages; from any thread."""
        self._alarms.put(alarm)

    def anomaly(self, score: float) -> None:
        """Send the compensator's score with the next messages; from any thread."""
        self._alarms.put(score)

    def tick(self, aircraft: int | None) -> None:
        """Send periodic messages.

        Args:
            aircraft: System id of the aircraft; that of the twin must differ.
        """
        if aircraft == self.system:
            self.system = self._packer.srcSystem = aircraft % 255 + 1
        now = time.monotonic()
        if now >= self._next_beat_s:
            self._send(heartbeat(self._motors))
            self._next_beat_s = now + _BEAT_S
        with contextlib.suppress(Empty):
            while True:
                found = self._alarms.get_nowait()
                if isinstance(found, Alarm):
                    self._send_alarm(found)
                else:
                    self._number(ANOMALY, found)

    def reading(self, t_us: int, twin: FollowingTwin, came_s: float) -> None:
        """Publish the twin's readings, 50 times a second.

        Args:
            t_us: Time on the aircraft's clock.
            twin: Twin at that time.
            came_s: Arrival of the message that caused the reading, s of the monotonic clock.
        """
        if t_us < self._next_us and self._next_us - t_us < 10 * _EVERY_US:
            return
        self._next_us, self._newest_us = t_us + _EVERY_US, t_us
        for message in messages_of_twin(t_us, twin.read()):
            self._send(message)
        self._ages_s.append(time.monotonic() - came_s)

    def _send_alarm(self, alarm: Alarm) -> None:
        """Send an alarm as text, in pieces, and as a number."""
        over = alarm.closed_s is not None
        severity = dialect.MAV_SEVERITY_NOTICE if over else dialect.MAV_SEVERITY_WARNING
        text = sentence(alarm).replace("±", "+/-").encode("ascii", "replace")
        pieces = [text[k : k + _TEXT] for k in range(0, len(text), _TEXT)]
        number = self.sent % 65535 + 1 if len(pieces) > 1 else 0
        for k, piece in enumerate(pieces):
            self._send(dialect.MAVLink_statustext_message(severity, piece, number, k))
        self._number(alarm.event.cause, 0.0 if over else alarm.event.probability)

    def _number(self, name: str, value: float) -> None:
        """Message NAMED_VALUE_FLOAT."""
        short = name.encode("ascii", "replace")[:_NAME]
        at_ms = self._newest_us // 1000 & 0xFFFFFFFF
        self._send(dialect.MAVLink_named_value_float_message(at_ms, short, value))

    def _send(self, message: Message) -> None:
        frame = packed(message, self._packer)
        with contextlib.suppress(OSError):  # no listener there yet
            self._socket.sendto(frame, self._to.pair)
            self.sent += 1


def messages_of_twin(t_us: int, reading: Reading) -> list[Message]:
    """Attitude, position and IMU of the twin."""
    sensed = dict(zip((*ACC, *GYRO), (*reading.acc_b, *reading.gyro_b), strict=True))
    messages = [
        attitude(t_us, reading.q_nb, reading.omega_b),
        local_position(t_us, reading.position_n, reading.velocity_n),
        imu(t_us, sensed),
    ]
    return [m for m in messages if m is not None]
