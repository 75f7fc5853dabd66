"""What is said to have happened to a calibrated aircraft, by class."""

from .outcomes import Outcome

ROTOR, _LOSS = "rotor_efficiency_loss", "loss_"
CLASSES = {
    "rotor": {ROTOR},
    "payload": {"mass_offset"},
    "slung": {"slung_load"},
    "accelerometer": {"accel_bias"},
    "gyroscope": {"gyro_bias"},
}
_MOVED = {"cog_offset", "inertia_error"}
"""They come with a payload and say nothing by themselves."""


def class_said(o: Outcome) -> str:
    """Class of the surest name; "none" where nothing was found, "other" where it has no class."""
    if o.verdict == "nothing":
        return "none"
    first = next((n for n in o.named if n not in _MOVED), "")
    return next((c for c, names in CLASSES.items() if first in names), "other")


def classes_said(o: Outcome) -> set[str]:
    """That class, and those of what cannot be told from the surest name."""
    first = next((n for n in o.named if n not in _MOVED), "")
    names = o.indistinguishable_from(first) if first else set()
    return {class_said(o)} | {c for c, of_class in CLASSES.items() if names & of_class}


def rotor_of(o: Outcome) -> int:
    """Number of the rotor that has lost thrust."""
    (effect,) = (e for e in o.truth["effects"] if e["name"] == ROTOR)
    (loss,) = effect["parameters"]
    return _number(loss)


def rotor_said(o: Outcome) -> int | None:
    """Number of the rotor with the largest loss that was named."""
    losses = [
        (float(p["value"]), _number(name))
        for e in o.said["effects"]
        if o.verdict == "named" and e["name"] == ROTOR
        for name, p in e["parameters"].items()
        if name.startswith(_LOSS)
    ]
    return max(losses)[1] if losses else None


def _number(name: str) -> int:
    """Of the rotor that a loss belongs to."""
    return int(name.removeprefix(_LOSS))
