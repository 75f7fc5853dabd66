"""Vehicles: the numbers of one aircraft, with the text of their file."""

import json
from dataclasses import asdict, dataclass, field, fields, replace
from pathlib import Path
from typing import Any, Self

import numpy as np

from twin import vehicle as numbers
from twin.component import unknown_name
from twin.errors import ModelError, TwinError
from twin.vehicle_file import builtin_vehicles, parse_vehicle, vehicle_text
from twin.vehicle_file.write import update_text

from .output import output_file

GROUNDED = "DOES NOT FLY: "
"""Prefix of the text on a twin that cannot fly, in a comment at the top of its vehicle file and in
the description of its FMUs."""


@dataclass(frozen=True, slots=True, repr=False, eq=False)
class Vehicle(numbers.Vehicle):
    """One aircraft, as `twin.vehicle.Vehicle`, that can be saved.

    This class is part of the user interface because the numbers themselves do not depend on a file
    format: imports point downwards.

    Attributes:
        text: Text of the vehicle file from which it was read; "" where it was created in Python.
            Changed copies (`with_mass`, `dataclasses.replace`) retain it, and with it the comments.
    """

    text: str = field(default="", repr=False, compare=False)

    @classmethod
    def of(cls, given: numbers.Vehicle, text: str = "") -> Self:
        """The vehicle with a text; an existing text is retained."""
        if isinstance(given, cls):
            return given
        values = {f.name: getattr(given, f.name) for f in fields(numbers.Vehicle)}
        return cls(**values, text=text)

    @property
    def grounded(self) -> str:
        """Reason why its twin cannot fly, from its file; "": none."""
        lines = (line for line in self.text.splitlines() if line.startswith(f"# {GROUNDED}"))
        return next(lines, "").removeprefix(f"# {GROUNDED}")

    def marked(self, why: str) -> Self:
        """The vehicle with a comment at the top of its file on why its twin cannot fly; "": without
        one."""
        lines = self.toml().splitlines(keepends=True)
        plain = "".join(x for x in lines if not x.startswith(f"# {GROUNDED}"))
        return replace(self, text=f"# {GROUNDED}{why}\n{plain}" if why else plain)

    def toml(self) -> str:
        """Text of a vehicle file of this vehicle: the original one with updated numbers.

        Raises:
            ModelError: The format cannot represent the vehicle.
        """
        return update_text(self, self.text, f"{self.name}.toml")

    def save(self, path: str | Path) -> Path:
        """Write a vehicle file; an existing one is replaced atomically.

        Raises:
            TwinError: The file cannot be written, or cannot represent the vehicle.
        """
        path, text = Path(path), self.toml()
        with output_file(path) as file:
            file.write_text(text, "utf-8")
        return path


def load_vehicle(name_or_path: str | Path) -> Vehicle:
    """Read a vehicle file, or a built-in vehicle by its name.

    Raises:
        ModelError: No such vehicle, or an invalid file; the text names file, key and value.
    """
    text, file = vehicle_text(name_or_path)
    return Vehicle.of(parse_vehicle(text, file), text)


def content_of(vehicle: numbers.Vehicle) -> str:
    """All that a vehicle states, as JSON: equal for equal vehicles, whatever file they are from."""
    unstated = {f.name for f in fields(vehicle) if not f.compare}
    stated = {k: v for k, v in asdict(vehicle).items() if k not in unstated}
    return json.dumps(stated, default=np.ndarray.tolist, sort_keys=True)


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
    """The vehicle in a file of another simulator: Gazebo, drone-models, PyFlyt, JSBSim.

    `docs/reference/simulators.md` lists the key of each of their numbers. `text` begins with the
    omitted numbers.

    Args:
        path: Path of the file; its format is recognised by content.
        name: Name of the aircraft, where the file contains several.

    Raises:
        ModelError: No such file, an unknown format, or a vehicle that a vehicle file cannot
            describe; the text says what to do.
    """
    from twin.vehicle_file import convert  # converters are imported only here

    text = convert.convert_vehicle(path, name)
    return Vehicle.of(parse_vehicle(text, Path(path).name), text)


def checked_vehicle(given: Any, verb: str) -> Vehicle:
    """A vehicle given to a function; `text` describes the valid arguments.

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
