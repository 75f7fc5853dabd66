"""The twin as a second MAVLink aircraft, for the screens of ground stations."""

import contextlib
import time
from collections import deque
from queue import Empty, SimpleQueue

import numpy as np

from twin.errors import TwinError
from twin.explain.running.alarms import Alarm
from twin.logs.columns import ACC, GYRO
from twin.logs.mavlink.encode import attitude, heartbeat, imu, local_position
from twin.logs.mavlink.frames import AUTOPILOT, Message, dialect, parser

from .address import Address, sending
from .alarms import sentence
from .following import FollowingTwin, Reading

DEFAULT_SYSTEM = 2
_EVERY_US = 20_000
_BEAT_S = 1.0
ANOMALY = "anomaly"
"""Name of the compensator's score."""
_TEXT, _NAME = 50, 10
"""Characters of a STATUSTEXT, and of a NAMED_VALUE_FLOAT."""
_AGES = 10_000


class Publisher:
    """Sends what the twin reads.

    Attributes:
        system: Own system id.
        sent: How many messages were sent.
    """

    def __init__(self, to: Address, motors: int, system: int = DEFAULT_SYSTEM) -> None:
        """Open the way there.

        Raises:
            TwinError: There is no such host, or the system id is none.
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
        """Give the socket back."""
        self._socket.close()

    @property
    def age_p99_s(self) -> float:
        """From when a message of the aircraft came to when the twin's left that was made of it, of
        99 in 100; NaN before any was sent."""
        return float(np.percentile(self._ages_s, 99)) if self._ages_s else float("nan")

    def alarm(self, alarm: Alarm) -> None:
        """Tell an alarm with the next messages; from any thread."""
        self._alarms.put(alarm)

    def anomaly(self, score: float) -> None:
        """Tell the compensator's score with the next messages; from any thread."""
        self._alarms.put(score)

    def tick(self, aircraft: int | None) -> None:
        """What is due without a new reading.

        Args:
            aircraft: System id of the aircraft; the twin takes another.
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
        """Publish what the twin reads, 50 times a second.

        Args:
            t_us: On the aircraft's clock.
            twin: At that time.
            came_s: When the message came that it was made of, s of the monotonic clock.
        """
        if t_us < self._next_us and self._next_us - t_us < 10 * _EVERY_US:
            return
        self._next_us, self._newest_us = t_us + _EVERY_US, t_us
        for message in messages_of_twin(t_us, twin.read()):
            self._send(message)
        self._ages_s.append(time.monotonic() - came_s)

    def _send_alarm(self, alarm: Alarm) -> None:
        """As text, in pieces, and as a number."""
        over = alarm.closed_s is not None
        severity = dialect.MAV_SEVERITY_NOTICE if over else dialect.MAV_SEVERITY_WARNING
        text = sentence(alarm).replace("±", "+/-").encode("ascii", "replace")
        pieces = [text[k : k + _TEXT] for k in range(0, len(text), _TEXT)]
        number = self.sent % 65535 + 1 if len(pieces) > 1 else 0
        for k, piece in enumerate(pieces):
            self._send(dialect.MAVLink_statustext_message(severity, piece, number, k))
        self._number(alarm.effect, 0.0 if over else alarm.probability)

    def _number(self, name: str, value: float) -> None:
        """NAMED_VALUE_FLOAT."""
        short = name.encode("ascii", "replace")[:_NAME]
        at_ms = self._newest_us // 1000 & 0xFFFFFFFF
        self._send(dialect.MAVLink_named_value_float_message(at_ms, short, value))

    def _send(self, message: Message) -> None:
        frame = message.pack(self._packer)
        self._packer.seq = (self._packer.seq + 1) % 256
        with contextlib.suppress(OSError):  # nobody listens there, as yet
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
