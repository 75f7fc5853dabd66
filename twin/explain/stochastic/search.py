"""Effects that change no mean, found by repeats and by spectra.

| seen as | seen in | told from others by |
|---|---|---|
| Repeats | a reading that repeats exactly | the other axes go on meanwhile |
| NoiseFloor | flat part of the spectrum, all axes | same level in every part of the band |
| Lines | lines that follow the rotors, or stand | level over the neighbouring frequencies |
| RandomForce | slow part of the accelerometer | no curve explains it, it falls with frequency |

Every claim rests on a ratio and on how far such ratios go astray without the effect: noise given
in a vehicle file, smoothness of a spectrum, motion that no model has quite right.
"""

from collections.abc import Mapping, Sequence

from ...effects import EFFECTS, Lines, NoiseFloor, RandomForce, Repeats
from ..model.model import Model
from ..settings import DEFAULT, StochasticSettings
from .finding import StochasticEffect, prior_log_odds
from .gust import find_gust
from .noise_level import find_noise_level
from .stuck import Stuck, stuck_numbers
from .vibration import find_vibration


def find_stochastic(
    model: Model, values: Mapping[str, float], settings: StochasticSettings = DEFAULT.stochastic
) -> list[StochasticEffect]:
    """Effects without a mean that the flights show, the surest first.

    Args:
        model: Flights, stuck readings taken out.
        values: Numbers of the effects that have been named, "effect.number" -> value.
        settings: Of each kind.
    """
    found = []
    for effect in EFFECTS.values():
        match effect.observable_as:
            case NoiseFloor():
                found.append(find_noise_level(model, effect, settings))
            case Lines():
                found.append(find_vibration(model, effect, settings))
            case RandomForce():
                found.append(find_gust(model, values, effect, settings))
    return sorted((u for u in found if u is not None), key=lambda u: -u.log_odds)


def find_stuck(
    stuck: Sequence[Stuck], settings: StochasticSettings = DEFAULT.stochastic
) -> list[StochasticEffect]:
    """The effects of readings that stand still; none where all go on."""
    if not stuck:
        return []
    channels = tuple(dict.fromkeys(s.channel for s in stuck))
    odds = -prior_log_odds(settings)
    return [
        StochasticEffect(e.name, odds, stuck_numbers(stuck, e), {}, channels, 1.0)
        for e in EFFECTS.values()
        if isinstance(e.observable_as, Repeats)
    ]
