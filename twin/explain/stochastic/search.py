"""Effects that change no mean, found by repeats and by spectra.

| effect | seen in | told from others by |
|---|---|---|
| stuck_sensor | a reading that repeats exactly | the other axes go on meanwhile |
| sensor_noise_level | flat part of the spectrum, all axes | same level in every part of the band |
| vibration | lines that follow the rotors, or stand | level over the neighbouring frequencies |
| gust | slow part of the accelerometer residual | no curve explains it, falls with frequency |

Every claim rests on a ratio and on how far such ratios go astray without the effect: noise given
in a vehicle file, smoothness of a spectrum, motion that no model has quite right.
"""

from collections.abc import Mapping, Sequence

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
    found = [
        find_noise_level(model, settings),
        find_vibration(model, settings),
        find_gust(model, values, settings),
    ]
    return sorted((u for u in found if u is not None), key=lambda u: -u.log_odds)


def find_stuck(
    stuck: Sequence[Stuck], settings: StochasticSettings = DEFAULT.stochastic
) -> list[StochasticEffect]:
    """The effect of readings that stand still; none where all go on."""
    if not stuck:
        return []
    channels = tuple(dict.fromkeys(s.channel for s in stuck))
    odds = -prior_log_odds(settings)
    return [StochasticEffect("stuck_sensor", odds, stuck_numbers(stuck), {}, channels, 1.0)]
