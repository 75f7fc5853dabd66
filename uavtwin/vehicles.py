"""Vehicles: the numbers of one aircraft, together with the text of the file that they came from."""

from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any, Self

from twin import vehicle as numbers
from twin.component import unknown_name
from twin.errors import ModelError, TwinError
from twin.vehicle_file import builtin_vehicles, parse_vehicle, vehicle_text
from twin.vehicle_file.write import update_text

from .output import output_file

GROUNDED = "DOES NOT FLY: "
"""Stands in front of what a twin does not fly and what to do about it, in a comment on top of its
vehicle file and in the description of its FMUs."""


@dataclass(frozen=True, slots=True, repr=False, eq=False)
class Vehicle(numbers.Vehicle):
    """One aircraft, as `twin.vehicle.Vehicle`, that can be saved.

    It is a class of the front door because the numbers themselves know no file format: imports
    point downwards.

    Attributes:
        text: Text of the vehicle file that it was read from; "" where it was made in Python.
            Changed copies (`with_mass`, `dataclasses.replace`) keep it, and with it the comments.
    """

    text: str = field(default="", repr=False, compare=False)

    @classmethod
    def of(cls, given: numbers.Vehicle, text: str = "") -> Self:
        """The same numbers with a text; one that has its own keeps it."""
        if isinstance(given, cls):
            return given
        values = {f.name: getattr(given, f.name) for f in fields(numbers.Vehicle)}
        return cls(**values, text=text)

    @property
    def grounded(self) -> str:
        """Why its twin does not fly, as its file says; "": it does not say so."""
        lines = (line for line in self.text.splitlines() if line.startswith(f"# {GROUNDED}"))
        return next(lines, "").removeprefix(f"# {GROUNDED}")

    def marked(self, why: str) -> Self:
        """The same with a line on top of its file that says why its twin does not fly; "": without
        one."""
        lines = self.toml().splitlines(keepends=True)
        plain = "".join(x for x in lines if not x.startswith(f"# {GROUNDED}"))
        return replace(self, text=f"# {GROUNDED}{why}\n{plain}" if why else plain)

    def toml(self) -> str:
        """Text of a vehicle file of this vehicle: that it was read from, brought up to date.

        Raises:
            ModelError: The format cannot hold the vehicle.
        """
        return update_text(self, self.text, f"{self.name}.toml")

    def save(self, path: str | Path) -> Path:
        """Write a vehicle file; one of this name is replaced, at once and as a whole.

        Raises:
            TwinError: The file cannot be written, or cannot hold the vehicle.
        """
        path, text = Path(path), self.toml()
        with output_file(path) as file:
            file.write_text(text, "utf-8")
        return path


def load_vehicle(name_or_path: str | Path) -> Vehicle:
    """Read a vehicle file, or a built-in vehicle by its name.

    Raises:
        ModelError: No such vehicle, or the file is wrong; the text names file, key and value.
    """
    text, file = vehicle_text(name_or_path)
    return Vehicle.of(parse_vehicle(text, file), text)


def vehicle(name: str) -> Vehicle:
    """A built-in vehicle by its name.

    Raises:
        ModelError: There is none of this name.
    """
    known = builtin_vehicles()
    if name not in known:
        raise ModelError(unknown_name("vehicle", "built-in vehicle", name, known))
    return load_vehicle(name)


def convert_vehicle(path: str | Path, name: str | None = None) -> Vehicle:
    """The vehicle that a file of another simulator describes: Gazebo, drone-models, PyFlyt, JSBSim.

    `docs/reference/simulators.md` says which of their numbers goes where. `text` begins
    with what was left out.

    Args:
        path: The file; its format is recognised by what it holds.
        name: Name of the aircraft, where the file holds several.

    Raises:
        ModelError: No such file, a format that is not known, or a vehicle that a vehicle file
            cannot describe; the text says what to do.
    """
    from twin.vehicle_file import convert  # readers of other simulators, for this alone

    text = convert.convert_vehicle(path, name)
    return Vehicle.of(parse_vehicle(text, Path(path).name), text)


def checked_vehicle(given: Any, verb: str) -> Vehicle:
    """A vehicle that was handed to a function, with a text that says what else it should be.

    Raises:
        TwinError: It is no vehicle.
    """
    if isinstance(given, numbers.Vehicle):
        return Vehicle.of(given)
    raise TwinError(
        f"{verb}: the vehicle is {_kind(given)}. Give a vehicle: vehicle(NAME) of "
        f"{', '.join(builtin_vehicles())}, or load_vehicle(FILE)."
    )


def _kind(given: object) -> str:
    """A wrong argument in words."""
    return f"the text {given!r}" if isinstance(given, str) else f"a {type(given).__name__}"
