"""Autopilot of `uavtwin live --hil --demo`: a stand-in for PX4, the project's controller behind
real MAVLink messages.

It reads the true motion of HIL_STATE_QUATERNION, as an estimator without errors would, and answers
each HIL_SENSOR with HIL_ACTUATOR_CONTROLS of its time, as PX4 does in lockstep.
"""

import math
import socket
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin.component.component import Run
from twin.flight.closed_loop import SETPOINTS, STEP_S
from twin.flight.lqr import controller
from twin.frames import AXES
from twin.logs.mavlink.encode import Controls, heartbeat, hil_controls
from twin.logs.mavlink.frames import Message, dialect, parser
from twin.vehicle import Vehicle
from twin.vehicle.earth import ned_of_geodetic

from ..hil.session import PLACE
from ..sockets import Address
from .flights import Waypoints, setpoints_along

Array = NDArray[np.float64]
STATE_US = 1000
"""Requested interval of HIL_STATE_QUATERNION, microseconds: one before each HIL_SENSOR."""
HOP: Waypoints = (
    ("ground", 0.5, (0.0, 0.0, 0.0)),
    ("takeoff", 2.0, (0.0, 0.0, -1.5)),
    ("forward", 3.0, (2.0, 1.0, -2.0)),
    ("hover", 1.5, (2.0, 1.0, -2.0)),
)
"""Waypoints of a short flight of seven seconds: phase, duration, s, and position reached, m NED."""


@dataclass
class Pilot:
    """The project's controller along waypoints, once per HIL_SENSOR.

    Attributes:
        vehicle: Vehicle for which it is designed.
        waypoints: Waypoints of its flight.
    """

    vehicle: Vehicle
    waypoints: Waypoints = HOP

    def __post_init__(self) -> None:
        control = controller(self.vehicle)
        self._setpoints, _ = setpoints_along(self.vehicle, self.waypoints)
        self._u, self._names = control.input_values(), control.input_names
        self._run = Run(control, self._u, control.parameter_values())
        self._before_us: int | None = None

    @property
    def seconds(self) -> float:
        """Length of its flight, s."""
        return STEP_S * len(self._setpoints)

    def controls(self, t_us: int, motion: dict[str, float]) -> Controls:
        """Controls for a motion at a time: `pos_x`, `vel_x`, `q_w`, `omega_x` and so on."""
        before_us = t_us if self._before_us is None else self._before_us
        if t_us > before_us:
            self._run.step(1e-6 * before_us, 1e-6 * (t_us - before_us), self._u)
        self._before_us = t_us
        row = self._setpoints[min(t_us // 1000, len(self._setpoints) - 1)]
        known = motion | dict(zip(SETPOINTS, row.tolist(), strict=True))
        self._u[:] = [known[n] for n in self._names]
        asked = tuple(self._run.outputs(self._u).tolist())
        return Controls(t_us, asked, bool(known["armed"]), lockstep=True)


def motion_of(state: Message, origin: Sequence[float] = PLACE) -> dict[str, float]:
    """The motion in a HIL_STATE_QUATERNION, by column, SI, NED from an origin, FRD."""
    place = math.radians(1e-7 * state.lat), math.radians(1e-7 * state.lon), 1e-3 * state.alt
    vectors: dict[str, Sequence[float]] = {
        "pos": ned_of_geodetic(place, *origin).tolist(),
        "vel": [1e-2 * v for v in (state.vx, state.vy, state.vz)],
        "omega": (state.rollspeed, state.pitchspeed, state.yawspeed),
    }
    named = {
        f"{n}_{a}": v for n, values in vectors.items() for a, v in zip(AXES, values, strict=True)
    }
    return named | dict(zip(("q_w", "q_x", "q_y", "q_z"), state.attitude_quaternion, strict=True))


@dataclass
class StandIn:
    """A simulated autopilot that connects and flies.

    Attributes:
        pilot: Pilot with the controller.
        answers: Changes a controls message before it is sent; None: it is not sent.
        place: Place of the start: latitude, longitude, rad; height above the ellipsoid, m.
        on_message: Called with each received message.
    """

    pilot: Pilot
    answers: Callable[[Controls], Controls | None] = lambda controls: controls
    place: Sequence[float] = PLACE
    on_message: Callable[[Message], object] = lambda _: None

    def fly(self, where: Address) -> None:
        """Connect and fly until the simulator disconnects."""
        with socket.create_connection(where.pair, timeout=20) as wire:
            self._fly(wire)

    def _fly(self, wire: socket.socket) -> None:
        packer, reader = parser(1, 1), parser()

        def send(message: Any) -> None:
            wire.sendall(message.pack(packer))
            packer.seq = (packer.seq + 1) % 256

        send(heartbeat(4, armed=False))
        send(
            dialect.MAVLink_command_long_message(
                *(0, 0, dialect.MAV_CMD_SET_MESSAGE_INTERVAL, 0),
                *(dialect.MAVLINK_MSG_ID_HIL_STATE_QUATERNION, STATE_US, 0, 0, 0, 0, 0),
            )
        )
        motion: dict[str, float] | None = None
        while octets := wire.recv(65536):
            for message in reader.parse_buffer(octets) or ():
                self.on_message(message)
                kind = message.get_type()
                if kind == "HIL_STATE_QUATERNION":
                    motion = motion_of(message, self.place)
                if kind != "HIL_SENSOR" or motion is None:
                    continue
                answer = self.answers(self.pilot.controls(message.time_usec, motion))
                if answer is not None:
                    send(hil_controls(answer))


@contextmanager
def flown_meanwhile(pilot: Pilot, simulator: Address, place: Sequence[float]) -> Iterator[None]:
    """Connect to a simulator and fly it, in the background, until it disconnects.

    Args:
        pilot: Pilot with the controller.
        simulator: Address of the simulator.
        place: Place of the start, as in `StandIn`.

    Raises:
        Exception: From the pilot, after the simulator has disconnected.
    """
    failed: list[Exception] = []

    def fly() -> None:
        """Run in a separate thread; a disconnection is the end, no error."""
        try:
            with suppress(OSError):
                StandIn(pilot, place=place).fly(simulator)
        except Exception as error:
            failed.append(error)

    thread = threading.Thread(target=fly, name="demo autopilot", daemon=True)
    thread.start()
    try:
        yield
    finally:
        thread.join()
    if failed:
        raise failed[0]
