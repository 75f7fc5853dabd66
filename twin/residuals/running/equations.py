"""The equations of a twin, ready for use: they take a second to build, which no flight has."""

from dataclasses import dataclass
from typing import Self

from ...component import Component
from ...component.rows import OverRows
from ...physics.rotors import Drive
from ...vehicle import Vehicle
from ..airborne import rotor_thrust
from ..aligned import components_of
from ..imu import imu_predictor
from ..short_horizon import Windows


@dataclass(frozen=True, slots=True)
class Equations:
    """What is evaluated of a twin.

    Attributes:
        drive: What drives its rotors.
        airframe: As of `AlignedFlight`.
        imu: As of `AlignedFlight`.
        imu_predictor: What the IMU reads at measured states.
        thrust: Of all rotors.
        windows: For the short horizon.
    """

    drive: Drive
    airframe: Component
    imu: Component
    imu_predictor: OverRows
    thrust: OverRows
    windows: Windows

    @classmethod
    def of(cls, vehicle: Vehicle, drive: Drive) -> Self:
        """Those of a vehicle."""
        body, sensor = components_of(vehicle, drive)
        return cls(
            drive,
            body,
            sensor,
            imu_predictor(body, vehicle),
            rotor_thrust(body, vehicle.rotors.count),
            Windows(body, sensor),
        )
