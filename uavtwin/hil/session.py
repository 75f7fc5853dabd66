"""PX4's simulator interface in lockstep: sensors out, motor commands in, alternately.

    the twin advances by a period  ->  HIL_GPS, HIL_STATE_QUATERNION, HIL_SENSOR
                                  <-  HIL_ACTUATOR_CONTROLS of the time of that HIL_SENSOR

An autopilot in lockstep takes its clock from HIL_SENSOR and answers each; the twin waits for the
answer. Until the first one it does not: PX4 needs a running clock to start. An autopilot that is
not in lockstep (`flags` of HIL_ACTUATOR_CONTROLS), as on its own board, is simulated in real time
with its newest commands.

Source: PX4's simulator_mavlink, and its simulators (Gazebo Classic, jMAVSim): sensors at 250 Hz,
lockstep from the first answer on.
"""

import math
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field

import numpy as np

from twin.errors import TwinError
from twin.logs.mavlink.encode import (
    BARO_BITS,
    IMU_BITS,
    MAG_BITS,
    Controls,
    SensorReadings,
    controls_of,
    heartbeat,
    hil_gps,
    hil_sensor,
    hil_state,
)
from twin.logs.mavlink.frames import Message, dialect
from twin.physics.sensors.position import PRESETS
from twin.vehicle import Vehicle
from twin.vehicle.earth import LAPSE_K_M, geodetic_of_ned

from ..sockets import Address
from .flying import FlyingTwin, TwinState
from .link import AutopilotLink, ConnectionEndedError


@dataclass(frozen=True, slots=True)
class HilStatus:
    """Status of a flight with an autopilot.

    Attributes:
        peer: Autopilot, HOST:PORT; "": none connected.
        flight_s: Simulated time.
        wall_s: Wall-clock time since the connection.
        answers: Number of HIL_ACTUATOR_CONTROLS received.
        lockstep: Whether the autopilot waits for the simulator.
        armed: Whether motors may turn at present.
        armed_s: Simulated time for which motors were allowed to turn.
        position_n: True position, m, NED.
        clipped: Number of motor commands outside 0..1, which were clipped.
        unknown: Number of NaN motor commands while armed, which were replaced by 0.
        link: Counts of messages, garbage, refused connections.
        ended: Reason for the end; "": in progress.
        fine: Whether it ended as requested.
    """

    peer: str = ""
    flight_s: float = 0.0
    wall_s: float = 0.0
    answers: int = 0
    lockstep: bool = False
    armed: bool = False
    armed_s: float = 0.0
    position_n: tuple[float, float, float] = (0.0, 0.0, 0.0)
    clipped: int = 0
    unknown: int = 0
    link: Mapping[str, int] = field(default_factory=dict)
    ended: str = ""
    fine: bool = True

    def line(self) -> str:
        """The status in one line for a terminal."""
        if not self.peer:
            return "no autopilot has connected yet"
        north, east, down = self.position_n
        parts = [
            f"{self.flight_s:.1f} s, {self.flight_s / max(self.wall_s, 1e-9):.2f} of real time",
            f"{self.answers} answers{' in lockstep' if self.lockstep else ''}",
            "armed" if self.armed else "not armed",
            f"{north:.2f} m north, {east:.2f} m east, {-down:.2f} m up",
        ]
        if self.link.get("garbage") or self.link.get("wrong"):
            parts.append(f"{self.link['garbage']} bytes of garbage, {self.link['wrong']} wrong")
        return "; ".join(parts)


STEP_HZ = 1000
"""Steps of the twin per second; HIL_SENSOR is sent after an integer number of them."""
PLACE = (math.radians(48.0), math.radians(11.0), 500.0)
"""Place of the default magnetic field: `EARTH_FIELD_N_T`."""
SLOW_S, GPS_S, BEAT_S = 0.02, 0.1, 1.0
"""Interval of readings of magnetometer and barometer, of the receiver, and of heartbeats."""
_LATE_S = 0.1
"""Delay behind the clock beyond which the lost time is not made up."""


@dataclass(frozen=True, slots=True)
class HilOptions:
    """Options of a flight with an autopilot.

    Attributes:
        serve: Address to which it connects.
        rate_hz: Rate of HIL_SENSOR; 1000 over an integer.
        speed: Largest multiple of real time; infinite: as fast as both can. In lockstep only.
        patience_s: Longest time for an answer of the autopilot.
        duration_s: Simulated time at which it ends; None: unlimited.
        start_s: Longest time for the first answer, in which the autopilot starts.
        place: Place of the start: latitude, longitude, rad; height above the ellipsoid, m.

    Raises:
        TwinError: A number is out of bounds.
    """

    serve: Address
    rate_hz: float = 250.0
    speed: float = 1.0
    patience_s: float = 10.0
    duration_s: float | None = None
    start_s: float = 60.0
    place: tuple[float, float, float] = PLACE

    def __post_init__(self) -> None:
        steps = STEP_HZ / self.rate_hz if self.rate_hz > 0 else 0.0
        if not 1 <= steps <= 100 or abs(steps - round(steps)) > 1e-9:
            raise TwinError(f"--rate {self.rate_hz:g}: 1000 over a whole number, 250 for PX4.")
        if not self.speed > 0:
            raise TwinError(f"--speed {self.speed:g}: more than 0, or max.")
        if not 0 < self.patience_s <= 3600:
            raise TwinError(f"--patience {self.patience_s:g}: up to 3600 s.")
        latitude, longitude, height_m = self.place
        if not (abs(latitude) <= math.pi / 2 and abs(longitude) <= math.pi and height_m >= -500):
            raise TwinError("--place: LATITUDE,LONGITUDE,HEIGHT in degrees and m: 48,11,500.")


class HilSession:
    """Session of one twin and its autopilot."""

    def __init__(self, vehicle: Vehicle, twin: FlyingTwin, options: HilOptions) -> None:
        """Open the port.

        Args:
            vehicle: Numbers of the twin.
            twin: Twin at its start.
            options: Options of the session.

        Raises:
            TwinError: The address cannot be used.
        """
        self.options, self._twin, self._vehicle = options, twin, vehicle
        self.link = AutopilotLink(options.serve, options.patience_s)
        self._period_us = round(1e6 / options.rate_hz)
        self._state_every = 1
        self._controls: Controls | None = None
        self._heard_s = 0.0
        self._answers = self._clipped = self._unknown = self._armed_steps = 0
        self._count = 0
        self._began_s = self._due_s = 0.0

    def run(
        self,
        stop: Callable[[], bool] = lambda: False,
        on_status: Callable[[HilStatus], None] = lambda _: None,
        every_s: float = 1.0,
    ) -> HilStatus:
        """Wait for an autopilot and simulate until the end of the session.

        Args:
            stop: Whether to end now.
            on_status: Called with the status, every `every_s`.
            every_s: Interval between two calls of it.

        Returns:
            Status at the end.
        """
        try:
            if not self.link.wait(stop):
                return self.known("ended before an autopilot connected", False)
            self._began_s = self._due_s = self._heard_s = time.monotonic()
            next_status_s = self._began_s
            while not stop():
                if self._is_over():
                    return self.known("the duration is over")
                self._advance()
                if time.monotonic() >= next_status_s:
                    on_status(self.known())
                    next_status_s += every_s
            return self.known("ended by hand")
        except ConnectionEndedError as error:
            return self.known(f"{error}, at {self._flight_s:.3f} s of the flight", False)
        finally:
            self.link.close()

    @property
    def _flight_s(self) -> float:
        return self._count * self._period_us / 1e6

    def _is_over(self) -> bool:
        duration_s = self.options.duration_s
        return duration_s is not None and self._flight_s >= duration_s - 1e-9

    # -- one period ---------------------------------------------------------------------------

    def _advance(self) -> None:
        """Step the twin, send its readings, and wait for the next commands."""
        commands = self.commands(self._controls)
        self._count += 1
        self._armed_steps += self._controls is not None and self._controls.armed
        state = self._twin.fly(commands, self._flight_s)
        self.link.send(self.messages(self._count, state))
        if self._in_lockstep:
            self._await(self._count * self._period_us)
        self._keep_pace()

    @property
    def _in_lockstep(self) -> bool:
        return self._controls is not None and self._controls.lockstep

    def commands(self, controls: Controls | None) -> list[float]:
        """Motor commands from controls, 0..1: zero while disarmed."""
        if controls is None or not controls.armed:
            return [0.0] * self._twin.motors
        found = []
        for value in controls.values[: self._twin.motors]:
            self._unknown += not math.isfinite(value)
            known = value if math.isfinite(value) else 0.0
            self._clipped += not 0.0 <= known <= 1.0
            found.append(min(max(known, 0.0), 1.0))
        return found

    def messages(self, count: int, state: TwinState) -> list[Message]:
        """Messages after a number of periods; HIL_SENSOR last, since it is answered."""
        t_us = count * self._period_us
        found = []
        if self._is_due(count, BEAT_S):
            found.append(heartbeat(self._twin.motors))
        if self._is_due(count, GPS_S):
            accuracy_m = max(PRESETS["gnss"].noise_m)
            place = self._place(state["gps_pos"])
            found.append(hil_gps(t_us, place, state["gps_vel"], accuracy_m))
        if self._state_every and count % self._state_every == 0:
            through = np.subtract(state["vel"], state["wind"])
            found.append(
                hil_state(
                    t_us,
                    state["q"],
                    state["omega"],
                    self._place(state["pos"]),
                    state["vel"],
                    state["force"],
                    float(np.linalg.norm(through)),
                )
            )
        sensed = SensorReadings(
            state["acc"],
            state["gyro"],
            state["mag"],
            state["baro"][0],
            self._vehicle.sensors.temperature_k + LAPSE_K_M * state["pos"][2],
        )
        updated = IMU_BITS | (MAG_BITS | BARO_BITS if self._is_due(count, SLOW_S) else 0)
        found.append(hil_sensor(t_us, sensed, updated))
        return found

    def _is_due(self, count: int, period_s: float) -> bool:
        """Whether a message with a period of its own is due; also at the first time."""
        every = max(1, round(1e6 * period_s / self._period_us))
        return count % every == 1 % every

    def _place(self, position_n: list[float]) -> list[float]:
        """Latitude, longitude, height of a position."""
        found: list[float] = geodetic_of_ned(np.array([position_n]), *self.options.place)[
            0
        ].tolist()
        return found

    # -- what comes ---------------------------------------------------------------------------

    def _await(self, t_us: int) -> None:
        """Wait for the answer to the HIL_SENSOR of a time."""
        until = time.monotonic() + self.options.patience_s
        while self._controls is not None and self._controls.t_us < t_us:
            left_s = until - time.monotonic()
            if left_s <= 0.0:
                raise ConnectionEndedError(self._no_answer(t_us))
            self._take(left_s)
            if not self._in_lockstep:
                return

    def _no_answer(self, t_us: int) -> str:
        """Text on why no answer was valid."""
        assert self._controls is not None
        heard_s = time.monotonic() - self._heard_s
        if heard_s < self.options.patience_s:
            return (
                f"the autopilot at {self.link.peer} answers with times of its own "
                f"({1e-6 * self._controls.t_us:.3f} s after HIL_SENSOR of {1e-6 * t_us:.3f} s): in "
                f"lockstep its clock is that of HIL_SENSOR"
            )
        return f"the autopilot at {self.link.peer} has not answered for {heard_s:.1f} s"

    def _keep_pace(self) -> None:
        """Wait for the clock, and receive messages meanwhile."""
        speed = self.options.speed if self._in_lockstep else 1.0
        self._due_s += 1e-6 * self._period_us / speed
        now = time.monotonic()
        if now - self._due_s > _LATE_S:
            self._due_s = now
        self._take(0.0)
        while (left_s := self._due_s - time.monotonic()) > 0.0:
            self._take(left_s)
        silent_s = time.monotonic() - self._heard_s
        if self._controls is None and silent_s > self.options.start_s:
            raise ConnectionEndedError(
                f"{self.link.peer} has sent no HIL_ACTUATOR_CONTROLS within "
                f"{self.options.start_s:g} s: is it an autopilot in simulation?"
            )
        if self._controls is not None and silent_s > self.options.patience_s:
            raise ConnectionEndedError(self._no_answer(0))

    def _take(self, wait_s: float) -> None:
        """Process messages that have arrived, or arrive within a time."""
        for message in self.link.messages(wait_s):
            kind = message.get_type()
            if kind == "HIL_ACTUATOR_CONTROLS":
                self._controls = controls_of(message)
                self._answers += 1
                self._heard_s = time.monotonic()
            elif kind == "COMMAND_LONG" and message.command == dialect.MAV_CMD_SET_MESSAGE_INTERVAL:
                self._set_interval(message)

    def _set_interval(self, m: Message) -> None:
        """Set the rate of the true motion; all other rates are those of the sensors."""
        if m.param1 != dialect.MAVLINK_MSG_ID_HIL_STATE_QUATERNION or not math.isfinite(m.param2):
            return
        every = max(1, round(m.param2 / self._period_us)) if m.param2 >= 0 else 0
        self._state_every = every

    # -- what is known ------------------------------------------------------------------------

    def known(self, ended: str = "", fine: bool = True) -> HilStatus:
        """Present status."""
        north, east, down = self._twin.now()["pos"]
        controls = self._controls
        return HilStatus(
            self.link.peer,
            self._flight_s,
            time.monotonic() - self._began_s if self.link.peer else 0.0,
            self._answers,
            self._in_lockstep,
            controls is not None and controls.armed,
            self._armed_steps * self._period_us / 1e6,
            (north, east, down),
            self._clipped,
            self._unknown,
            asdict(self.link.counts),
            ended,
            fine,
        )
