"""On which channels and in which phases an effect acts: a model with it against one without it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..representation import short_repr
from ..residuals.channels import GRID_HZ, ChannelData
from .model.model import Model
from .settings import DEFAULT, AttributionSettings

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Attribution:
    """One effect among those added.

    Attributes:
        effect: Identifier.
        channels: On which it acts, the clearest first.
        phases: In which it acts on the clearest one, the strongest first.
        without: Channels of each flight without the effect, all others on.
    """

    effect: str
    channels: tuple[str, ...]
    phases: tuple[str, ...]
    without: Sequence[Sequence[ChannelData]]

    __repr__ = short_repr


def attribute_effect(
    effect: str,
    model: Model,
    values: Mapping[str, float],
    with_all: Sequence[Sequence[ChannelData]],
    settings: AttributionSettings = DEFAULT.attribution,
) -> Attribution:
    """Where an effect acts.

    Args:
        effect: Identifier.
        model: Flights, against the model as it stood.
        values: Numbers of all added effects, "effect.number" -> value.
        with_all: Channels of each flight with all of them.
        settings: From when on an effect acts.
    """
    others = {k: v for k, v in values.items() if k.partition(".")[0] != effect}
    without = model.channels([], others)
    taken = {}
    for i, channel in enumerate(with_all[0]):
        lacking, complete = (
            np.concatenate([f[i].residual for f in flights]) for flights in (without, with_all)
        )
        power, left = float(lacking @ lacking), float(complete @ complete)
        taken[channel.name] = 1 - left / power if power > 0 else 0.0
    ranked = sorted(taken, key=lambda name: -taken[name])
    channels = tuple(name for name in ranked if taken[name] >= settings.least_share) or tuple(
        ranked[:1]
    )
    phases = _phases(channels[0], model, without, with_all, settings.strong)
    return Attribution(effect, channels, phases, without)


def _phases(
    name: str,
    model: Model,
    without: Sequence[Sequence[ChannelData]],
    with_all: Sequence[Sequence[ChannelData]],
    strong: float,
) -> tuple[str, ...]:
    """Phases in which an effect changes a channel most."""
    i = next(i for i, c in enumerate(with_all[0]) if c.name == name)
    phase, change = [], []
    for flight, a, b in zip(model.flights, without, with_all, strict=True):
        t0 = flight.aligned.inputs.t_s[0]
        phase.append(flight.aligned.phases[np.rint((a[i].t_s - t0) * GRID_HZ).astype(np.intp)])
        change.append(a[i].residual - b[i].residual)
    names, values = np.concatenate(phase), np.concatenate(change)
    size = {str(p): float(np.sqrt(np.mean(values[names == p] ** 2))) for p in np.unique(names)}
    strongest = max(size.values())
    return tuple(p for p in sorted(size, key=lambda p: -size[p]) if size[p] >= strong * strongest)
