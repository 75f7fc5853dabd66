"""Live session: receives an aircraft, records it, and runs its twin."""

import contextlib
import math
import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from twin.component.along import BUILDING
from twin.errors import TwinError
from twin.logs.flight import Finding
from twin.logs.mavlink.decoder import MavlinkDecoder, Sample, Stamp
from twin.logs.mavlink.frames import AUTOPILOT, Message, dialect, packed, parser
from twin.residuals.flight_gap import DEFAULT_HORIZON_S
from twin.vehicle import Vehicle
from twin.why.watch import Alarm

from ..sockets import Address, listening
from .datagrams import Arrivals, ClockWatch, Datagram, Received, Receiver
from .following import DEFAULT_SYSTEM, Following, FollowingTwin, Publisher
from .page.feed import PageFeed
from .recording import HOLD_S, Recording, RowBuffer
from .status import RATES_HZ, FlightWatch, LinkStatus, LiveStatus, alarm_json, missing
from .worker import Batch, FaultIsolation, Part, Worker

if TYPE_CHECKING:
    from ..compensators.running import RunningCompensator

HAND_OVER_S = 0.1
"""Interval at which rows are passed to the twin and to the disk."""
ASK_S = 0.5
"""Interval of requests for the aircraft's time."""
SILENT_S = 2.0
"""Silence after which the aircraft may send from another port of its machine."""
_PAUSE_S = 0.5
"""Silence after which reordered messages are no longer awaited."""
_WAIT_S = 0.05
"""Longest wait for a datagram, s. Made up."""
_AT_ONCE = 200
"""Datagrams that are received before other tasks."""
_GATHER_S = 0.02
"""Time in which more datagrams are collected before they are received: waking up costs as much as
some messages. Publication does not wait."""
_MANY = 50
"""Number of datagrams at once from which the next ones are not awaited."""
_CLOCKED = ("acc", "gyro")
"""Signals whose times determine the aircraft's clock."""


@dataclass(frozen=True, slots=True)
class LiveOptions:
    """Options of a live session.

    Attributes:
        listen: Address to which the aircraft sends.
        system: System id of the aircraft; None: the first one received.
        record: Folder of the recording; None: no recording.
        horizon_s: Short horizon of the residuals.
        observer_s: Time constant of the observer for the displayed and published twin; None: its
            state is set to the measured one at every horizon.
        hold_s: Time for which rows wait for reordered messages.
        duration_s: Duration of the session; None: unlimited.
        until_silent_s: Silence of an aircraft after which the session ends.
        request_rates: Whether streams are requested from the aircraft, the only command that is
            sent.
        publish: Address to which the twin is sent as a separate aircraft; None: not sent.
        publish_system: System id of the twin.

    Raises:
        TwinError: A number is out of bounds.
    """

    listen: Address
    system: int | None = None
    record: Path | None = None
    horizon_s: float = DEFAULT_HORIZON_S
    hold_s: float = HOLD_S
    duration_s: float | None = None
    until_silent_s: float | None = None
    request_rates: bool = False
    publish: Address | None = None
    publish_system: int = DEFAULT_SYSTEM
    observer_s: float | None = None

    def __post_init__(self) -> None:
        steps = 1e3 * self.horizon_s
        if not 0.01 <= self.horizon_s <= 60 or abs(steps - round(steps)) > 1e-6:
            raise TwinError(f"--horizon {self.horizon_s:g}: a multiple of 1 ms of at least 10 ms.")
        if not 0 <= self.hold_s <= 10:
            raise TwinError(f"--hold {self.hold_s:g}: 0 to 10 s.")
        if self.observer_s is not None and not 0.02 <= self.observer_s <= 60:
            raise TwinError(f"--observer {self.observer_s:g}: 0.02 to 60 s.")

    @property
    def following(self) -> Following:
        """Correction of the twin's state."""
        return Following(self.horizon_s, self.observer_s)


class LiveSession:
    """Session with one aircraft and its twin.

    It sends only TIMESYNC to the aircraft, a request for the time; no heartbeat, since an autopilot
    that has received one interprets its end as a lost link.
    """

    def __init__(
        self,
        vehicle: Vehicle,
        options: LiveOptions,
        watch: Callable[[], FlightWatch | None] = lambda: None,
        page: PageFeed | None = None,
        compensator: "RunningCompensator | None" = None,
    ) -> None:
        """Open the port, and start the recording.

        Args:
            vehicle: Vehicle of the twin.
            options: Options of the session.
            watch: Creates the diagnosis of a flight section; None: no alarms.
            page: Receives the content of the page; None: no page.
            compensator: Compensator of the sensors; None: there is none.

        Raises:
            TwinError: The address or the folder cannot be used.
        """
        self.options, self._vehicle, self._page = options, vehicle, page
        self._motors = vehicle.rotors.count
        self._socket = listening(options.listen)
        self._arrivals = Arrivals(self._socket)
        self._gathers, self._count = options.publish is None, 0
        try:
            self._recording = (
                None if options.record is None else Recording(options.record, self._motors)
            )
        except TwinError:
            self._socket.close()
            raise
        self._receiver = Receiver(options.system)
        self._heard_s = time.monotonic()
        self._packer = parser(255, dialect.MAV_COMP_ID_ONBOARD_COMPUTER)
        self._parts = FaultIsolation(options.record)
        self._decoder, self._request_ns = MavlinkDecoder(self._motors), 0
        self._alarms: dict[tuple[int, str, float], dict[str, Any]] = {}
        self._late = self._astray = 0
        self._requested = False
        self._begin()
        self._publisher = (
            None
            if options.publish is None
            else Publisher(options.publish, self._motors, options.publish_system)
        )
        on_block = (lambda _: None) if page is None else page.block
        self.worker = Worker(
            vehicle,
            self._recording,
            options.horizon_s,
            watch,
            on_block,
            self._alarm,
            compensator,
            (lambda _: None) if self._publisher is None else self._publisher.anomaly,
            self._parts,
        )
        with BUILDING:
            self._twin = FollowingTwin(self.worker.equations, options.following)

    def _begin(self) -> None:
        """Reset everything that depends on the aircraft's clock."""
        self._rows = RowBuffer(round(1e6 * self.options.hold_s))
        self._clock = ClockWatch()

    def run(
        self,
        stop: Callable[[], bool] = lambda: False,
        on_status: Callable[[LiveStatus], None] = lambda _: None,
        every_s: float = 1.0,
    ) -> LiveStatus:
        """Run until the end of the session.

        Args:
            stop: Whether to end now.
            on_status: Called with the status, every `every_s`.
            every_s: Interval between two calls of it.

        Returns:
            Status at the end.
        """
        began = time.monotonic()
        self._heard_s = began
        next_rows = next_status = began
        next_ask = began
        began_cpu = time.process_time()
        try:
            while not stop():
                self._receive()
                now = time.monotonic()
                if now >= next_rows:
                    self.hand_over(now - self._heard_s > max(_PAUSE_S, 2 * self.options.hold_s))
                    next_rows = now + HAND_OVER_S
                if self._publisher is not None:
                    tick, aircraft = self._publisher.tick, self._receiver.system
                    self._parts.run(Part.PUBLISHER, tick, aircraft)
                if now >= next_ask:
                    self._ask()
                    next_ask = now + ASK_S
                if now >= next_status:
                    busy = (time.process_time() - began_cpu) / max(now - began, 1e-3)
                    self._parts.run(Part.PAGE, on_status, self.known(busy))
                    next_status = now + every_s
                if self._is_over(now, began):
                    break
        finally:
            self._close()
        return self.known((time.process_time() - began_cpu) / (time.monotonic() - began))

    def _alarm(self, alarm: Alarm) -> None:
        """Report an alarm that was raised or has ended, in the thread of the twin."""
        entry = alarm_json(alarm, self.worker.sections)
        self._alarms[entry["section"], alarm.event.cause, alarm.raised_s] = entry
        if self._publisher is not None:
            self._publisher.alarm(alarm)
        if self._page is not None:
            self._parts.run(Part.PAGE, self._page.alarm, alarm, self.worker.sections)

    def _is_over(self, now: float, began: float) -> bool:
        options = self.options
        if options.duration_s is not None and now - began >= options.duration_s:
            return True
        heard = self._receiver.sender is not None
        silent_s = options.until_silent_s
        return heard and silent_s is not None and now - self._heard_s >= silent_s

    def end(self) -> LiveStatus:
        """End without `run`: received data are recorded; returns the final status."""
        self._close()
        return self.known()

    def _close(self) -> None:
        with ExitStack() as stack:
            stack.callback(self._end_recording)
            stack.callback(self.worker.close)
            if self._publisher is not None:
                stack.callback(self._publisher.close)
            stack.callback(self._socket.close)
            self.hand_over(True)

    def _end_recording(self) -> None:
        if self._recording is not None:
            self._parts.wake()
            self._parts.run(Part.TABLES, self._recording.close)

    # -- what comes ---------------------------------------------------------------------------

    def _receive(self) -> None:
        """Receive datagrams for some time."""
        come = self._arrivals.wait(_WAIT_S)
        self._receiver.silent = time.monotonic() - self._heard_s > SILENT_S
        if not come:
            return
        if self._gathers and self._count < _MANY:
            time.sleep(_GATHER_S)
        self._count = 0
        for datagram in self._arrivals.take(_AT_ONCE):
            self.take(datagram)
            self._count += 1

    def take(self, datagram: Datagram) -> None:
        """Process a datagram: record its messages, pass their samples on."""
        come = self._parts.run(Part.RECEIVER, self._messages, datagram)
        for received in come or ():
            self._heard_s, self._receiver.silent = time.monotonic(), False
            if self._recording is not None:
                self._parts.run(Part.RAW, self._recording.raw.add, datagram.at_us, received.frame)
            self._parts.run(Part.DECODER, self._take_message, received.message, datagram.at_s)
            self._request_rates()

    def _messages(self, datagram: Datagram) -> list[Received]:
        return list(self._receiver.messages(datagram.content, datagram.sender))

    def _take_message(self, message: Message, at_s: float) -> None:
        if message.get_type() == "TIMESYNC":
            self._timesync(message, at_s)
            return
        if message.get_type() == "STATUSTEXT" and self._page is not None:
            said = int(message.severity), str(message.text)
            self._parts.run(Part.PAGE, self._page.said, *said)
        samples = self._decoder.samples(message)
        if self._decoder.stamp is Stamp.RESTART:
            self._new_section()
        elif self._decoder.stamp is Stamp.MISLED:
            self._forget_strays()
        for sample in samples:
            self._take_sample(sample, at_s)

    def _take_sample(self, sample: Sample, at_s: float) -> None:
        if sample.group in _CLOCKED:
            self._clock.came(sample.t_us * 1e-6, at_s)
        self._rows.add(sample)
        if self._publisher is not None or self._page is not None:
            self._parts.run(Part.SHOWN, self._follow, sample, at_s)

    def _follow(self, sample: Sample, at_s: float) -> None:
        """Step the displayed and published twin up to a sample."""
        flies = self._twin.take(sample)
        if flies and self._publisher is not None:
            self._publisher.reading(sample.t_us, self._twin, at_s)
        if self._page is not None:
            self._parts.run(Part.PAGE, self._show, self._page, sample, flies, at_s)

    def _show(self, page: PageFeed, sample: Sample, flies: bool, at_s: float) -> None:
        """Pass new data to the page, at readings of the gyroscope."""
        page.sample(sample)
        zero_us = self._rows.zero_us
        if sample.group == "gyro" and zero_us is not None and page.is_due(at_s):
            reading = self._twin.read() if flies else None
            page.state(1e-6 * (sample.t_us - zero_us), reading, at_s)

    def _new_section(self) -> None:
        """Start a new section: the aircraft's clock restarted."""
        self.hand_over(True)
        self._late += sum(self._rows.late.values())
        self._decoder.dropped.clear()
        self._twin.restart()
        self._begin()
        self.worker.new_section()

    def _forget_strays(self) -> None:
        """Drop all data so far, which had stray stamps."""
        if self._rows.zero_us is not None:  # its recorded rows remain a flight section
            self._new_section()
            return
        self._astray += self._rows.waiting
        self._twin.restart()
        self._begin()

    def hand_over(self, everything: bool = False) -> None:
        """Pass rows to the twin and to the disk."""
        rows = self._parts.run(Part.ROWS, self._rows.take, everything)
        if rows is not None:
            self.worker.add(Batch(rows, *self._noted()))
        if self._recording is not None:
            self._parts.run(Part.RAW, self._recording.raw.flush)

    def _noted(self) -> tuple[dict[str, str], tuple[Finding, ...]]:
        """Facts and findings of the flight so far, for the recording."""
        return ({}, ()) if self._recording is None else (self._facts(), self._findings())

    # -- what is sent -------------------------------------------------------------------------

    def _send(self, message: Message) -> None:
        if self._receiver.sender is None:
            return
        frame = packed(message, self._packer)
        with contextlib.suppress(OSError):  # it no longer exists
            self._socket.sendto(frame, self._receiver.sender)

    def _ask(self) -> None:
        """Request the aircraft's time."""
        self._request_ns = time.monotonic_ns()
        self._send(dialect.MAVLink_timesync_message(0, self._request_ns))

    def _timesync(self, m: Message, at_s: float) -> None:
        """Answer a request for the time, or process an answer.

        The answer contains the middle between request and answer, so that the delay in between has
        no effect.
        """
        if not m.tc1:
            answered_s = (at_s + time.monotonic()) / 2
            self._send(dialect.MAVLink_timesync_message(round(1e9 * answered_s), m.ts1))
        elif not self._decoder.is_near(m.tc1 // 1000):
            return  # from another clock than the stamps
        elif 0 < m.ts1 <= 1e9 * at_s and 1e9 * at_s - m.ts1 < 10e9:
            self._clock.answered(1e-9 * m.ts1, 1e-9 * m.tc1, at_s)

    def _request_rates(self) -> None:
        """Request the streams that the twin needs, once, if enabled."""
        if not self.options.request_rates or self._requested:
            return
        self._requested = True
        for kind, rate_hz in RATES_HZ.items():
            command = dialect.MAVLink_command_long_message(
                self._receiver.system,
                AUTOPILOT,
                dialect.MAV_CMD_SET_MESSAGE_INTERVAL,
                0,
                *(kind, 1e6 / rate_hz, 0, 0, 0, 0, 0),
            )
            self._send(command)

    # -- what is known ------------------------------------------------------------------------

    def _facts(self) -> dict[str, str]:
        """Facts for the recording."""
        clock = self._clock.estimate()
        facts = {"aircraft": f"MAVLink system {self._receiver.system}"}
        if self._decoder.autopilot:
            facts["autopilot"] = self._decoder.autopilot
        if self._rows.zero_us is not None:
            facts["clock"] = f"t = 0 is {1e-6 * self._rows.zero_us:.0f} s on the aircraft's clock"
        if clock is not None:
            facts["clock offset"] = f"{clock.offset_s:.4f} s, {clock.drift_ppm:.1f} ppm"
        return facts | {f"source {g}": s for g, s in self._rows.sources.items()}

    def _findings(self) -> tuple[Finding, ...]:
        """Findings for the recording."""
        total, found = self._receiver.sequence, []
        if total.lost:
            found.append(Finding("warning", "link", "messages lost on the way", total.lost))
        for (group, why), count in sorted(self._decoder.dropped.items()):
            found.append(Finding("error", group, f"samples left out: {why}", count))
        for group, count in sorted(self._rows.late.items()):
            message = f"samples left out, later than {self.options.hold_s:g} s"
            found.append(Finding("warning", group, message, count))
        return tuple(found)

    def known(self, busy: float = 0.0) -> LiveStatus:
        """Present status."""
        receiver, total = self._receiver, self._receiver.sequence
        sender = receiver.sender
        link = LinkStatus(
            receiver.system,
            "" if sender is None else f"{sender[0]}:{sender[1]}",
            total.received,
            total.lost,
            total.duplicates,
            total.reordered,
            total.jumps,
            self._late + sum(self._rows.late.values()),
            self._decoder.strays + self._astray,
            receiver.parser.garbage,
            receiver.parser.wrong,
            receiver.parser.version_1,
            dict(receiver.others),
        )
        worker = self.worker
        return LiveStatus(
            link,
            self._clock.estimate(),
            dict(self._rows.sources),
            missing(self._rows.sources),
            worker.waits_for,
            worker.sections,
            worker.flight_s,
            worker.rms,
            dict(worker.units),
            busy,
            math.nan if self._publisher is None else self._publisher.age_p99_s,
            tuple(list(self._alarms.values())),
            worker.model,
            worker.misfit,
            worker.rests,
            tuple(f"{f.where} {f.message}" for f in self._parts.findings),
        )
