"""What is said to have happened to a calibrated aircraft, by class."""

import re

from .outcomes import Outcome

CLASSES = {
    "rotor": {"rotor_efficiency_loss", "rotor_loss"},
    "payload": {"mass_offset", "payload"},
    "slung": {"slung_load"},
    "accelerometer": {"accel_bias"},
    "gyroscope": {"gyro_bias"},
}
_MOVED = "cog_offset"
"""It comes with a payload and says nothing by itself."""
_NUMBER = re.compile(r"(\d+)$")


def class_said(o: Outcome) -> str:
    """Class of the surest name; "none" where nothing was found, "other" where it has no class."""
    if o.verdict == "nothing":
        return "none"
    first = next((n for n in o.named if n != _MOVED), "")
    return next((c for c, names in CLASSES.items() if first in names), "other")


def classes_said(o: Outcome) -> set[str]:
    """That class, and those of what cannot be told from the surest name."""
    first = next((n for n in o.named if n != _MOVED), "")
    names = o.cannot_be_told_from(first) if first else set()
    return {class_said(o)} | {c for c, of_class in CLASSES.items() if names & of_class}


def rotor_of(o: Outcome) -> int:
    """Number of the rotor that has lost thrust."""
    effect = next(e for e in o.truth["effects"] if e["name"] == "rotor_efficiency_loss")
    return max(int(_number(k) or 0) for k in effect["parameters"])


def rotor_said(o: Outcome) -> int | None:
    """Number of the rotor with the largest loss that was named."""
    losses = [
        (float(p["value"]), _number(name) or _number(e["name"]))
        for e in o.said["effects"]
        if o.verdict == "named"
        for name, p in e["parameters"].items()
        if any(e["name"].startswith(n) for n in CLASSES["rotor"])
    ]
    return max(losses, key=lambda loss: loss[0])[1] if losses else None


def _number(name: str) -> int | None:
    """At the end of a name."""
    found = _NUMBER.search(name)
    return int(found[1]) if found else None
