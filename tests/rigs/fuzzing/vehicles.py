"""Vehicle files and designs of sweeps: numbers, keys, tables and lines of the TOML changed."""

import random
import re
from collections.abc import Callable
from dataclasses import dataclass
from importlib import resources
from itertools import islice
from pathlib import Path
from typing import Any

from uavtwin.simulation import Scenario
from uavtwin.sweeps.design import read_design
from uavtwin.sweeps.plan import scenario_of

from .checked import read_checked
from .engine import Seen, Step
from .flights import Long, apply_bytes, draw_bytes, spelled

_NUMBER = re.compile(r"(?<![\w.])-?\d+(?:\.\d+)?(?:e-?\d+)?(?![\w.])")
_KEY = re.compile(r"^[a-z_]+(?= =)|(?<=^\[)[a-z_]+|(?<=[{,] )[a-z_]+(?= =)", re.MULTILINE)
_STRING = re.compile(r'"[^"\n]*"')
_ABSURD: tuple[Long, ...] = (
    *("nan", "inf", "-inf", "1e308", "-1e308", "1e38", "1e999", "0.0", "-1.0", "1e-300", "0"),
    *(("9", 400), ("9", 5000), "0x7fffffffffffffff", "1_0", "true", '"4"', "[]", "[[1.0]]", "{}"),
    *("1979-05-27", "{ value = 1.0 }", ("[", 2000), ("[", 100_000), "'''"),
)
_TEXTS: tuple[Long, ...] = (
    *("", "x", "\\u0000", "\\uD800", ("x", 100_000), '", "', "cw", "N", "1e400 kg", "é/\u202e"),
    *("furlong", "kg*m^999999999", "kg**9**9**9", ("(", 5000), ("m*", 20_000), "__import__('os')"),
)
_NAMES = ("mass", "x", "value", "source", "unit", "a.b", "body.mass", '""', "é", "rotors", "site")
_BYTES = ("flip", "cut", "repeat", "remove")


_DESIGNS = {
    "hypercube": b"""method = "latin_hypercube"
runs = 64
seed = 3
[vary]
"airframe.mass" = { low = 1.2, high = 1.6 }
"wind.speed" = { mean = 4.0, sd = 2.0, low = 0.0, high = 12.0 }
"wind.direction" = { low = 0.0, high = 360.0 }
gusts = [true, false]
controller = ["lqr", "px4"]
""",
    "grid": b"""method = "grid"
[vary]
"effects.rotor_drag.scale" = { low = 0.5, high = 2.0, steps = 5, scale = "log" }
"airframe.mass" = [1.2, 1.4, 1.6]
""",
    "saltelli": b"""method = "saltelli"
runs = 64
[vary.airframe]
mass = { low = 1.2, high = 1.6 }
[vary.wind]
speed = { mean = 4.0, sd = 2.0 }
""",
}


def _built_in() -> dict[str, bytes]:
    folder = resources.files("twin.vehicle.built_in")
    files = (f for f in folder.iterdir() if f.name.endswith(".toml"))
    return {f.name.removesuffix(".toml"): f.read_bytes() for f in files}


def _read_design(path: Path) -> Seen:
    """As `uavtwin sweep` up to the first system that is built."""
    design = read_design(path)
    points = design.points()
    scenarios = [
        scenario_of(Scenario("tour"), point, design.seed + run)
        for run, point in enumerate(islice(points, 64))
    ]
    return Seen(repr((len(points), scenarios)), frozenset())


@dataclass(frozen=True)
class Toml:
    """A kind of TOML file."""

    file: str
    bases: Callable[[], dict[str, bytes]]
    read: Callable[[Path], Seen]
    visible: frozenset[str] = frozenset()

    def draw(self, rng: random.Random, blob: bytes) -> Step:
        """Most of them know the format."""
        if not blob or rng.random() < 0.1:
            return draw_bytes(rng, blob or b"\0")
        names = ("number", "scale", "text", "key", "lines", "copy", "deep", "wide", "table")
        name = rng.choices(names, (8, 4, 4, 4, 3, 3, 1, 1, 1))[0]
        given: dict[str, Any] = {"at": rng.randrange(10_000)}
        match name:
            case "number":
                given |= {"to": rng.choice(_ABSURD)}
            case "scale":
                given |= {"by": rng.choice((-1.0, 0.0, 1e-9, 1e-3, 1e3, 57.3, 1e9, 1e300))}
            case "text":
                given |= {"to": rng.choice(_TEXTS)}
            case "key" | "table":
                given |= {"to": rng.choice(_NAMES)}
            case "lines":
                given |= {"count": rng.choice((1, 1, 3))}
            case "copy":
                given |= {"times": rng.choice((1, 1, 5000))}
            case "deep":
                given |= {"depth": rng.choice((50, 500, 20_000)), "as": rng.choice(("[", "{", "."))}
            case "wide":
                given |= {"count": rng.choice((5, 1000, 50_000))}
        return name, given

    def apply(self, blob: bytes, step: Step) -> bytes:
        """As drawn."""
        name, given = step
        if name in _BYTES:
            return apply_bytes(blob, step)
        return _changed(blob.decode("utf-8", "surrogateescape"), name, given).encode(
            "utf-8", "surrogateescape"
        )


def _changed(text: str, name: str, given: dict[str, Any]) -> str:
    """A file with one change."""
    match name:
        case "number":
            return _put(text, _NUMBER, given["at"], spelled(given["to"]))
        case "scale":
            return _put(text, _NUMBER, given["at"], lambda old: repr(float(old) * given["by"]))
        case "text":
            return _put(text, _STRING, given["at"], f'"{spelled(given["to"])}"')
        case "key":
            return _put(text, _KEY, given["at"], given["to"])
        case "deep":
            return text + f"\n{_deep(given['as'], given['depth'])}\n"
        case "table":
            return text + f"\n[{given['to']}]\n"
    lines = text.splitlines(keepends=True) or [""]
    at = given["at"] % len(lines)
    match name:
        case "lines":
            del lines[at : at + given["count"]]
        case "copy":
            lines[at:at] = [lines[at]] * given["times"]
        case "wide":
            lines[at:at] = [f"key_{k} = {k}\n" for k in range(given["count"])]
    return "".join(lines)


def _deep(kind: str, depth: int) -> str:
    match kind:
        case "[":
            return f"deep = {'[' * depth}{']' * depth}"
        case "{":
            return f"deep = {'{a=' * depth}1{'}' * depth}"
        case _:
            return f"{'a.' * depth}a = 1"


def _put(text: str, what: re.Pattern[str], at: int, new: Any) -> str:
    """The text with one of what matches exchanged."""
    found = list(what.finditer(text))
    if not found:
        return text
    one = found[at % len(found)]
    return text[: one.start()] + (new if isinstance(new, str) else new(one[0])) + text[one.end() :]


VEHICLES = Toml("input.toml", _built_in, read_checked)
DESIGNS = Toml("design.toml", lambda: _DESIGNS, _read_design)
