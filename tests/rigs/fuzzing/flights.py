"""What flight logs of any format have in common here: bytes changed, and the flight read."""

import random
from pathlib import Path
from typing import Any

from places import DATA

from twin.logs import read_flight

from .engine import Seen, Step

ABSURD = (0.0, -1.0, float("nan"), float("inf"), -float("inf"), 1e38, -1e38, 1e10, 1e-40)


Long = str | tuple[str, int]
"""A text, or one and how often it is repeated: a recipe stays short."""


def spelled(value: Any) -> str:
    """The whole text; JSON has lists for tuples."""
    return value if isinstance(value, str) else value[0] * value[1]


def recorded(*patterns: str) -> dict[str, bytes]:
    """Recorded flights by name, where there are any."""
    return {p.stem: p.read_bytes() for g in patterns for p in sorted(DATA.glob(g))}


def read(path: Path) -> Seen:
    """The flight, its numbers as a hash and its findings as a user sees them."""
    flight = read_flight(path)
    told = {f"{f.where}: {f.message} ({f.count})" for f in flight.findings if f.severity != "info"}
    return Seen(flight.fingerprint, frozenset(told))


def draw_bytes(rng: random.Random, blob: bytes) -> Step:
    """Damage that knows nothing of the format; an earlier change may have left nothing."""
    if not blob:
        return "repeat", {"at": 0, "count": 1}
    end = len(blob) if rng.random() < 0.5 else min(len(blob), 60_000)
    at = rng.randrange(end)
    match rng.choice(("flip", "cut", "repeat", "remove")):
        case "flip":
            return "flip", {
                "seed": rng.getrandbits(32),
                "end": end,
                "count": rng.choice((1, 9, 99)),
            }
        case "cut":
            return "cut", {"at": at}
        case "repeat":
            return "repeat", {"at": at, "count": rng.choice((1, 64, 4096))}
        case _:
            return "remove", {"at": at, "count": rng.choice((1, 64, 4096))}


def apply_bytes(blob: bytes, step: Step) -> bytes:
    """As drawn by `draw_bytes`."""
    name, given = step
    if name == "flip":
        rng, out = random.Random(given["seed"]), bytearray(blob)
        for _ in range(given["count"] if out else 0):
            out[rng.randrange(min(given["end"], len(out)))] = rng.randrange(256)
        return bytes(out)
    at = given["at"]
    if name == "cut":
        return blob[:at]
    rest = blob[at : at + given["count"]]
    return blob[:at] + (rest + rest if name == "repeat" else b"") + blob[at + given["count"] :]
