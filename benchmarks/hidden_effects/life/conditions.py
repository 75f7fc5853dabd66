"""What a case has beside what is hidden in it; today's cases have nothing of it."""

from dataclasses import asdict, dataclass
from typing import Any

SENSORS = {
    "field": ("mag_", "baro_"),
    "velocity": ("vel_",),
    "inertial": ("acc_", "gyro_", "mag_", "baro_", "vel_"),
}
"""Columns of the flight table, by their beginnings, that go with a group of sensors."""
NORMAL_FLIGHTS = 5
"""Of a case in which something happens to a calibrated aircraft."""


@dataclass(frozen=True)
class Conditions:
    """How life is.

    Attributes:
        off: Whether the numbers of the vehicle file are off by their own standard deviations.
        days: Whether every flight has small constants of its own.
        rotors: Whether the log has rotor speeds in place of commands, and the file their map.
        without: Group of sensors that the log lacks, a key of `SENSORS`; "" for none.
        fits: Flights to fit on.
        slow: Whether all flights hover or go round at a walk.
    """

    off: bool = False
    days: bool = False
    rotors: bool = False
    without: str = ""
    fits: int = 2
    slow: bool = False

    @property
    def key(self) -> str:
        """Text that tells them from all others; empty for those of today's cases."""
        usual = asdict(Conditions())
        return ",".join(f"{k}={v}" for k, v in asdict(self).items() if v != usual[k])

    @property
    def as_json(self) -> dict[str, Any]:
        """For the truth file."""
        return asdict(self)
