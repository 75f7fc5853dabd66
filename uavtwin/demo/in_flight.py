"""Built-in aircraft of `uavtwin live --demo`, damaged in mid-flight.

It is simulated in closed loop beforehand and then sent over the loopback in real time by the sender
of `uavtwin replay`; the receiver cannot distinguish it from a real aircraft.
"""

import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress

from twin.effects.propulsion import ROTOR_EFFICIENCY_LOSS
from twin.flight.simulate_flight import Later, Recorder, Stream, simulate_flight
from twin.logs import Flight
from twin.logs.columns import ACC, GYRO, POS, QUAT, VEL, motor_columns
from twin.vehicle import Vehicle

from ..live.replay import Replay
from ..sockets import Address
from .flights import (
    ACC_NOISE_M_S2,
    ATT_NOISE,
    GYRO_NOISE_RAD_S,
    IMU_S,
    POS_NOISE_M,
    POSE_S,
    VEL_NOISE_M_S,
    Waypoints,
    setpoints_along,
)

BEGINS_S = 20.0
"""Time of the damage after the start of the flight: by then the receiver has learned the normal
state."""
LOSS, ROTOR = 0.2, 3
"""Lost share of a rotor's thrust, and the number of the rotor. Made up: a broken tip."""
SECONDS = 60.0
"""Length of the flight, s."""
_BATTERY_S, _BATTERY_NOISE = 0.1, 1e-3
"""Sample period of the battery, s, and noise of its voltage, V."""
_LEG_S = 3.0
"""Duration of each leg, s."""
_SQUARE = ((1.0, 0.0, -1.5), (1.0, 0.8, -2.0), (0.0, 0.8, -1.5), (0.0, 0.0, -1.5))
"""Corners of the squares, over the longest leg."""
_REACH_M, _SMALL_REACH_M, _SMALL_ARM_M = 5.0, 1.5, 0.06
"""Length of the legs, m, for a large and for a small aircraft, and the arm from which it is large,
m."""


def waypoints(vehicle: Vehicle, seconds: float = SECONDS) -> Waypoints:
    """Take-off, a hover, and squares until the end; without a landing.

    Args:
        vehicle: Vehicle that flies: a small one flies smaller squares.
        seconds: Duration.
    """
    reach = _SMALL_REACH_M if vehicle.arm_m < _SMALL_ARM_M else _REACH_M
    start = (0.0, 0.0, -1.5)
    legs = [("ground", 1.0, (0.0, 0.0, 0.0)), ("takeoff", 3.0, start), ("hover", 4.0, start)]
    while sum(leg[1] for leg in legs) < seconds:
        legs += [("forward", _LEG_S, (reach * x, reach * y, z)) for x, y, z in _SQUARE]
        legs.append(("hover", 2.0, start))
    return tuple(legs)


def damaged_flight(
    vehicle: Vehicle,
    begins_s: float = BEGINS_S,
    loss: float = LOSS,
    seconds: float = SECONDS,
    seed: int = 1,
) -> Flight:
    """A flight in which a rotor loses thrust.

    Args:
        vehicle: Vehicle that flies, and for which its controller is designed.
        begins_s: Start of the loss, s.
        loss: Lost share of its thrust.
        seconds: Duration of the flight, extended to a whole square.
        seed: Seed of the sensor noise.

    Raises:
        ModelError: The vehicle cannot hover.
    """
    setpoints, phases = setpoints_along(vehicle, waypoints(vehicle, seconds))
    drives = motor_columns("cmd" if vehicle.drive == "command" else "rotor", vehicle.rotors.count)
    numbers = {f"loss_{i}": loss * (i == ROTOR) for i in range(1, vehicle.rotors.count + 1)}
    streams = (
        Stream(drives, IMU_S),
        Stream(ACC, IMU_S, ACC_NOISE_M_S2),
        Stream(GYRO, IMU_S, GYRO_NOISE_RAD_S),
        Stream(POS, POSE_S, POS_NOISE_M),
        Stream(VEL, POSE_S, VEL_NOISE_M_S),
        Stream(QUAT, POSE_S, ATT_NOISE),
        Stream(("vbat_v",), _BATTERY_S, _BATTERY_NOISE * vehicle.voltage_v),
    )
    return simulate_flight(
        setpoints,
        phases,
        vehicle,
        vehicle,
        Recorder(streams, 1 / IMU_S, 1 / IMU_S, seed),
        "demo",
        later=Later({ROTOR_EFFICIENCY_LOSS.name: numbers | {"torque_share": 1.0}}, begins_s),
    )


def ending(begins_s: float = BEGINS_S, loss: float = LOSS) -> str:
    """Text on the true fault of such a flight."""
    return f"in this flight rotor {ROTOR} lost {100 * loss:.0f} % of its thrust at {begins_s:g} s"


@contextmanager
def sent_meanwhile(flight: Flight, to: Address) -> Iterator[None]:
    """Send a flight in real time, in the background, until the end of the context.

    Args:
        flight: Flight to send.
        to: Address of the listener.
    """
    sender, over = Replay(to), threading.Event()

    def go_on(_: float) -> None:
        """Called during sending."""
        if over.is_set():
            raise _EndedError

    def play() -> None:
        """Run in a separate thread."""
        with suppress(_EndedError):
            sender.play(flight, go_on)

    thread = threading.Thread(target=play, name="demo aircraft", daemon=True)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()
        sender.close()


class _EndedError(Exception):
    """There is no listener any more."""
