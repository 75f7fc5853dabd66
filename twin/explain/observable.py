"""Effects that a search can find in a flight: those that are observable in its columns."""

from collections.abc import Iterator
from dataclasses import dataclass

from ..effects import EFFECTS, Effect
from ..logs import AnyFlight
from ..logs.columns import MIN_MOTORS, motor_columns
from .model.numbers import ACCELEROMETER, GYROSCOPE, SIGNALS, lacking, on_the_body


@dataclass(frozen=True, slots=True)
class ObservableEffects:
    """Observability of effects in a flight.

    Attributes:
        effects: Observable effects by the component on which they act.
        unknown: The other effects by the missing signals, as text.
    """

    effects: dict[str, tuple[str, ...]]
    unknown: dict[str, tuple[str, ...]]


def observable_effects(flight: AnyFlight) -> ObservableEffects:
    """Effects that are observable in the columns of a flight, by the rule of the search itself.

    Duration and excitation of the flight are not considered.
    """
    drive = _no_drive(flight)
    observable: dict[str, list[str]] = {}
    unknown: dict[str, list[str]] = {}
    for effect in EFFECTS.values():
        missing = drive or "; ".join(_missing(effect, flight))
        if missing:
            unknown.setdefault(missing, []).append(effect.name)
        else:
            observable.setdefault(effect.component, []).append(effect.name)
    return ObservableEffects(
        {k: tuple(v) for k, v in observable.items()}, {k: tuple(v) for k, v in unknown.items()}
    )


def _no_drive(flight: AnyFlight) -> str:
    """Text on what is missing to drive a model, "" where nothing is."""
    for stem in ("cmd", "rotor"):
        count = sum(c.startswith(f"{stem}_") for c in flight.columns)
        if count >= MIN_MOTORS and flight.has(*motor_columns(stem, count)):
            return ""
    return "neither commands cmd_1..n nor speeds rotor_1..n of all motors"


def _missing(effect: Effect, flight: AnyFlight) -> Iterator[str]:
    """Texts on the signals that an effect lacks."""
    for signal in lacking(effect, flight):
        text = f"no {', '.join(SIGNALS[signal])}"
        if signal == "vel":
            text += " (or pos)"
        if on_the_body(effect) and signal == ACCELEROMETER:
            text += " (or q with vel, pos or acc_ned)"
        if on_the_body(effect) and signal == GYROSCOPE:
            text += " (or q)"
        yield text
