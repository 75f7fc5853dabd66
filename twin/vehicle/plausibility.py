"""Questions of a reviewer on the numbers of a vehicle: implausible ones, none of them impossible.

An impossible vehicle is refused, or reported as doubtful (`Vehicle.doubts`), when it is read.
"""

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ..representation import ShortRepr
from .vehicle import (
    DEFAULT,
    WORDS,
    Vehicle,
    first_reaching,
    hover_level,
    most_thrust_n,
    polynomial,
    relative_deviation,
)


@dataclass(frozen=True, slots=True)
class Question(ShortRepr):
    """A question on one key of a vehicle file.

    Attributes:
        key: Key of the vehicle file.
        value: Value of the key, in words.
        why: Reason why the value is implausible.
        way_out: What to check, or to write.
    """

    key: str
    value: str
    why: str
    way_out: str

    def __str__(self) -> str:
        """The question in one line."""
        return f"{self.key} = {self.value}: {self.why} {self.way_out}"


@dataclass(frozen=True, slots=True)
class Band:
    """Usual range of a quantity of multirotors.

    Attributes:
        quantity: Name of a dimensionless quantity.
        low: Lower end.
        high: Upper end.
        origin: Source of the limits.
    """

    quantity: str
    low: float
    high: float
    origin: str

    def misses(self, value: float) -> bool:
        """Whether a value is outside; true for NaN."""
        return not self.low <= value <= self.high

    def __str__(self) -> str:
        """The limits."""
        return f"{self.low:g} to {self.high:g}"


_SURVEYED = (
    "the built-in vehicles, Hummingbird (RotorS, RotorPy), Pelican (RotorS), Iris and X500 (PX4's "
    "Gazebo models), Crazyflie (Foerster 2015)"
)  # vehicles from which the bands are derived
FLATNESS = Band(
    "Izz over Ixx + Iyy",
    0.65,
    1.0,
    f"0.73 to 1.0 of {_SURVEYED}; 1 of a flat body, no body has more",
)  # a ratio
GYRATION_XY = Band(
    "radius of gyration about x and y over the arm",
    0.38,
    0.70,
    f"0.43 to 0.62 of {_SURVEYED}, an eighth wider",
)  # a ratio
GYRATION_Z = Band(
    "radius of gyration about z over the arm",
    0.52,
    0.86,
    "0.59 to 0.76 of the same, an eighth wider",
)  # a ratio
HOVER_COMMAND = Band(
    "command in hover", 0.2, 0.8, "below, the throttle has no resolution; above, no reserve"
)  # a ratio; by judgement
THRUST_TO_WEIGHT = Band(
    "largest thrust over weight", 1.3, 8.0, "freighters 1.5, cameras 2, racers 5 to 8"
)  # a ratio
TORQUE_ARM = Band(
    "reaction torque over thrust, over the arm",
    0.05,
    0.2,
    "0.065 to 0.15 of the same where propeller and frame belong together, a third wider; torque "
    "over thrust grows with the diameter of the propeller, and that with the arm",
)  # a ratio
BANDS = (FLATNESS, GYRATION_XY, GYRATION_Z, HOVER_COMMAND, THRUST_TO_WEIGHT, TORQUE_ARM)
"""All bands, for the documentation."""

_DIAGONAL = re.compile(r"diagonal|lateral|\b45\b", re.IGNORECASE)
"""Words of a source that hint at diagonal distances of the rotors."""
_FRAME_SIZE = re.compile(r"(?<![\d.])\d{3}(?![\d.])")
"""Frame size in a name, mm from motor to motor across: X150, F450."""
_NEAR = 0.03
"""Largest relative difference of frame sizes and distances of motors that count as equal."""
_LISTED = 5
"""Largest number of keys in a question."""


def questions(vehicle: Vehicle) -> tuple[Question, ...]:
    """All questions on a vehicle."""
    return tuple(
        question
        for ask in (
            flatness,
            gyration,
            arm,
            hover_command,
            thrust_to_weight,
            reaction_torque,
            missing_lag,
            hub_height,
            unknown_deviations,
        )
        for question in ask(vehicle)
    )


def flatness(vehicle: Vehicle) -> Iterator[Question]:
    """Question where the yaw moment of inertia is small relative to the other two; one above their
    sum is a doubt."""
    xx, yy, zz = np.diagonal(vehicle.inertia_kg_m2)
    ratio = zz / (xx + yy)
    if ratio < FLATNESS.low:
        yield Question(
            "body.inertia",
            f"[{xx:.4g}, {yy:.4g}, {zz:.4g}] kg*m^2",
            f"Izz is {ratio:.2f} of Ixx + Iyy; multirotors are flat and have {FLATNESS}.",
            "Is the order [Ixx, Iyy, Izz]? Is Izz about the axis that points down?",
        )


def gyration(vehicle: Vehicle) -> Iterator[Question]:
    """Question where inertia, mass and size are inconsistent."""
    if vehicle.arm_m == 0:
        return
    k = np.sqrt(np.diagonal(vehicle.inertia_kg_m2) / vehicle.mass_kg) / vehicle.arm_m
    odd = [
        f"{x:.2f} about {axis} ({band})"
        for axis, x, band in zip("xyz", k, (GYRATION_XY, GYRATION_XY, GYRATION_Z), strict=True)
        if band.misses(x)
    ]
    if odd:
        xx, yy, zz = np.diagonal(vehicle.inertia_kg_m2)
        yield Question(
            "body.inertia",
            f"[{xx:.4g}, {yy:.4g}, {zz:.4g}] kg*m^2",
            f"the radius of gyration of {vehicle.mass_kg:.4g} kg over the arm of "
            f"{vehicle.arm_m:.4g} m is {', '.join(odd)}; in brackets what multirotors have.",
            "Is the unit right (g*cm^2, kg*mm^2)? Is it the whole aircraft, battery included? Is "
            "the arm measured from the middle to a motor?",
        )


def arm(vehicle: Vehicle) -> Iterator[Question]:
    """Question where an arm, or a frame size, was probably used as the coordinate of the rotors."""
    x, y = np.abs(vehicle.rotors.position_m[:, :2]).T
    a_m, source = float(x[0]), vehicle.sources.get("rotors.position", "")
    if a_m == 0 or not (np.allclose(x, a_m, rtol=1e-6) and np.allclose(y, a_m, rtol=1e-6)):
        return
    across_mm = 2e3 * math.hypot(a_m, a_m)
    named = [
        float(n) for n in _FRAME_SIZE.findall(f"{vehicle.name} {vehicle.description} {source}")
    ]
    if any(abs(size / across_mm - 1) < _NEAR for size in named):
        return
    value = (
        f"{a_m:.4g} m forward and {a_m:.4g} m to the side: arm {vehicle.arm_m:.4g} m, "
        f"{across_mm:.0f} mm between motors across"
    )
    for factor in (math.sqrt(2), 1 / math.sqrt(2)):
        for size in (s for s in named if abs(s * factor / across_mm - 1) < _NEAR):
            yield Question(
                "rotors.position",
                value,
                f"the frame is called {size:g}, and frame sizes are mm between motors across.",
                f"For {size:g} mm across write {size / 2e3 / math.sqrt(2):.4g} m for "
                f"{a_m:.4g} m; if the rotors are where they are, say so in its source: "
                f'"..., diagonal {across_mm:.0f} mm".',
            )
            return
    if abs(1e3 * a_m - round(1e3 * a_m)) < 1e-6 and not _DIAGONAL.search(source):
        yield Question(
            "rotors.position",
            value,
            f"is {a_m:.4g} m the coordinate, or the arm from the middle to a motor?",
            f"If it is the arm, each coordinate is {a_m / math.sqrt(2):.4g} m; if not, say so in "
            f'its source: "..., diagonal {across_mm:.0f} mm".',
        )


def hover_command(vehicle: Vehicle) -> Iterator[Question]:
    """Question where the hover command is unusual."""
    if vehicle.drive != "command":
        return
    command, speed = hover_level(vehicle), vehicle.rotors.speed_rad_s
    if speed is not None:
        command = first_reaching(speed, command, 1.0)
    if HOVER_COMMAND.misses(command):
        yield Question(
            _map(vehicle),
            f"{command:.2f} in hover (0 to 1)",
            f"aircraft hover at {HOVER_COMMAND}.",
            "What does a log in hover say? Check rotors.command_range, the unit of the map and the "
            "mass.",
        )


def thrust_to_weight(vehicle: Vehicle) -> Iterator[Question]:
    """Question where the largest thrust is unusual."""
    if vehicle.drive != "command":
        return
    ratio = most_thrust_n(vehicle) / vehicle.hover_thrust_n
    if THRUST_TO_WEIGHT.misses(ratio):
        yield Question(
            _map(vehicle),
            f"{ratio:.2f} times the weight at full command",
            f"aircraft have {THRUST_TO_WEIGHT}.",
            "Is the map that of one rotor, in N and not in grams? Does it hold at the voltage of "
            "the flights?",
        )


def reaction_torque(vehicle: Vehicle) -> Iterator[Question]:
    """Question where torque over thrust is inconsistent with the size."""
    torque = polynomial(vehicle.rotors.torque_n_m, hover_level(vehicle))
    ratio_m = torque / vehicle.hover_thrust_n
    if vehicle.arm_m > 0 and TORQUE_ARM.misses(ratio_m / vehicle.arm_m):
        given = (k for k in vehicle.sources if k.startswith("rotors.torque_"))
        yield Question(
            next((k for k in given if not k.endswith("by_advance")), "rotors.torque_per_thrust"),
            f"{ratio_m:.4g} m of torque over thrust in hover",
            f"over the arm of {vehicle.arm_m:.4g} m that is {ratio_m / vehicle.arm_m:.2f}; "
            f"propellers that fit their frame have {TORQUE_ARM}.",
            "Does it belong to this propeller? It grows with the diameter. Are thrust and torque "
            "in N and N*m, of the same argument?",
        )


def missing_lag(vehicle: Vehicle) -> Iterator[Question]:
    """Question where the rotors follow their command without lag."""
    follows = vehicle.rotors.follows or "motor_lag" in vehicle.effects
    if vehicle.drive == "command" and not follows:
        yield Question(
            "rotors.lag",
            "none",
            "rotors take 15 to 75 ms to follow a command; without it the twin turns too early.",
            'If it is not known, write one that is: 0.03 s with the source "estimate".',
        )


def hub_height(vehicle: Vehicle) -> Iterator[Question]:
    """Question where the hubs are exactly in the plane of the centre of mass."""
    if not np.any(vehicle.rotors.position_m[:, 2]):
        yield Question(
            "rotors.position",
            "z = 0 m for all rotors",
            "are the hubs at the height of the centre of mass? Their drag in forward flight turns "
            "the nose by its lever.",
            "Give z, negative above the centre of mass; an estimate will do.",
        )


def unknown_deviations(vehicle: Vehicle) -> Iterator[Question]:
    """Question on numbers without a standard deviation."""
    keys = [
        key
        for key, source in vehicle.sources.items()
        if not source.startswith(DEFAULT)
        and key not in ("rotors.direction", "rotors.command_range")
        and relative_deviation(vehicle, key) is None
    ]
    if keys:
        listed = ", ".join(keys[:_LISTED]) + (", ..." if len(keys) > _LISTED else "")
        words = ", ".join(f"{row.words[0]} ({100 * row.share:g} %)" for row in WORDS)
        yield Question(
            "sd",
            f"not known of {len(keys)} entries",
            f"how well are these known: {listed}?",
            f'Write sd = "5 %" or sd = NUMBER into their braces, or one of these words into their '
            f"source: {words}.",
        )


def _map(vehicle: Vehicle) -> str:
    """The key of the map from command to thrust."""
    if vehicle.rotors.speed_rad_s is not None:
        return "rotors.speed_from_command"
    return "rotors.thrust_from_command"
