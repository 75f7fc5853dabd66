"""What convinces of an effect that changes a mean; flights before and after."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from twin.explain.attribution import Attribution
from twin.residuals.channels import BAND_HZ, CHANNEL_HZ, ChannelData
from twin.residuals.spectra import spectrum

from ..drawing.budget import Budget
from ..drawing.panels import Axis, Panels, Spans
from ..drawing.series import TREND_HZ
from ..figures import pretty_unit
from ..page import BLACK, BLUE, GREY, ORANGE, Figure

Array = NDArray[np.float64]
Flights = Sequence[Sequence[ChannelData]]
MOST_CHANNELS, MOST_FLIGHTS = 2, 2
MOST_DOTS = 600
"""Of a scatter; more lie on each other."""
LONGEST_S = 20.0
"""Of a flight that is shown at once; the strongest part of a longer one is looked at first."""
HELD = 0.95
"""Share of what an effect predicts that lies below the low-pass of its curves."""
VARIES = 0.25
"""Spread of what an effect predicts over its size, below which it is a constant: a scatter would be
one dot."""
STANDS_OUT = 0.5
"""Spread of what an effect predicts over that of what it leaves, below which a scatter is noise."""
BEFORE, AFTER, PREDICTED = "model as it stood", "model with the effect", "what the effect predicts"


def evidence_figure(
    acts: Attribution, with_all: Flights, flight: int, spans: Spans, time: str, budget: Budget
) -> Figure:
    """Residual without and with an effect over what the effect predicts, over time.

    A constant effect is seen as one: a residual that stands off zero all along.

    Args:
        acts: Where the effect acts.
        with_all: Channels of each flight with every added effect.
        flight: Which of them is shown.
        spans: Phases of it.
        time: Group of figures whose time axes move together.
        budget: Of the page.
    """
    names = acts.channels[:MOST_CHANNELS]
    panels = Panels((230,) * len(names), time)
    ends: list[tuple[float, float]] = []
    for name in names:
        without, complete = (_of(f[flight], name) for f in (acts.without, with_all))
        predicted = without.residual - complete.residual
        t = _broken(without, without.t_s)
        below_hz = _reaches_hz(without.t_s, predicted)
        axes = panels.add(f"residual of {name}, {pretty_unit(without.unit)}")
        for values, label, line in (
            (without.residual, f"left by the {BEFORE}", {"color": BLUE, "width": 1.6}),
            (complete.residual, f"left by the {AFTER}", {"color": ORANGE, "width": 1.6}),
            (predicted, PREDICTED, {"color": BLACK, "width": 1.6, "dash": "dash"}),
        ):
            band = label != PREDICTED
            shown = _broken(without, values)
            panels.series(axes, t, shown, label, line, budget.columns, band, below_hz)
        ends.append(strongest(without.t_s, predicted))
    panels.look(*ends[0], spans)
    return panels.figure


def agreement_figure(acts: Attribution, with_all: Flights, flight: int) -> Figure | None:
    """Residual without and with an effect over what the effect predicts of it; None where that is a
    constant, or lost in noise.

    Args:
        acts: Where the effect acts.
        with_all: Channels of each flight with every added effect.
        flight: Which of them is shown.
    """
    names = [n for n in acts.channels[:MOST_CHANNELS] if _varies_on(acts, with_all, flight, n)]
    if not names:
        return None
    panels = Panels((218,) * len(names))
    for i, name in enumerate(names):
        without, complete = (_of(f[flight], name) for f in (acts.without, with_all))
        predicted = without.residual - complete.residual
        unit = pretty_unit(without.unit)
        along: Axis = {"nticks": 5}
        if i == len(names) - 1:
            along["title"] = {"text": f"what the effect predicts, {unit}"}
        axes = panels.add(f"residual of {name}, {unit}", along)
        every = max(1, -(-len(predicted) // MOST_DOTS))
        for values, label, colour in (
            (without.residual, f"left by the {BEFORE}", BLUE),
            (complete.residual, f"left by the {AFTER}", ORANGE),
        ):
            panels.line(
                axes,
                predicted[::every],
                values[::every],
                label,
                {"color": colour},
                mode="markers",
                marker={"size": 4, "color": colour, "opacity": 0.5},
            )
        ends = np.array([predicted.min(), predicted.max()])
        line = {"color": BLACK, "width": 1.2, "dash": "dash"}
        panels.line(axes, ends, ends, "as much as it predicts", line)
    return panels.figure


def varies(predicted: Array, left: Array) -> bool:
    """Whether what an effect predicts is more than a constant, and not lost in what it leaves."""
    low, high = np.percentile(predicted, [2.5, 97.5])
    more = bool(high - low > VARIES * np.abs(predicted).max(initial=0.0))
    return more and bool(np.std(predicted) > STANDS_OUT * np.std(left))


def _varies_on(acts: Attribution, with_all: Flights, flight: int, name: str) -> bool:
    without, complete = (_of(f[flight], name) for f in (acts.without, with_all))
    return varies(without.residual - complete.residual, complete.residual)


def strongest(t_s: Array, predicted: Array) -> tuple[float, float]:
    """The span of time to look at: all of it, or `LONGEST_S` where an effect predicts most."""
    start, end = float(t_s[0]), float(t_s[-1])
    if end - start <= 1.3 * LONGEST_S:
        return start, end
    power = np.concatenate([[0.0], np.cumsum((predicted - np.mean(predicted)) ** 2)])
    behind = np.searchsorted(t_s, t_s + LONGEST_S)
    first = int(np.argmax(power[behind] - power[:-1]))
    first = int(np.searchsorted(t_s, min(float(t_s[first]), end - LONGEST_S)))
    return float(t_s[first]), float(t_s[first]) + LONGEST_S


def loudest(acts: Attribution, with_all: Flights) -> int:
    """The flight in which an effect predicts most of its clearest channel."""
    sizes = []
    for a, b in zip(acts.without, with_all, strict=True):
        one, two = (_of(f, acts.channels[0]) for f in (a, b))
        sizes.append(float(np.mean((one.residual - two.residual) ** 2)))
    return int(np.argmax(sizes))


def _reaches_hz(t_s: Array, predicted: Array) -> float:
    """Frequency below which most of what varies of a prediction lies; within what curves may be
    cut at."""
    s = spectrum(t_s, predicted)
    total = np.cumsum(s.psd)
    if not len(total) or total[-1] <= 0:
        return TREND_HZ
    reach = float(s.f_hz[int(np.searchsorted(total, HELD * total[-1]))])
    return float(np.clip(1.5 * reach, TREND_HZ, min(BAND_HZ, 0.4 * CHANNEL_HZ)))


def before_after_figure(
    before: ChannelData, after: ChannelData, spans: Spans, time: str, budget: Budget
) -> Figure:
    """Measured and both models, and both residuals, over time.

    Args:
        before: The channel of a held-out flight with the model as it stood.
        after: The same with the effects added.
        spans: Phases of the flight.
        time: Group of figures whose time axes move together.
        budget: Of the page.
    """
    unit = pretty_unit(before.unit)
    panels = Panels((190, 130), time)
    t = _broken(before, before.t_s)
    rows = (
        (
            before.name,
            (before.measured, "measured", BLACK, "solid"),
            (before.measured - before.residual, BEFORE, BLUE, "dash"),
            (after.measured - after.residual, AFTER, ORANGE, "solid"),
        ),
        (
            "residual",
            (before.residual, f"residual, {BEFORE}", GREY, "solid"),
            (after.residual, f"residual, {AFTER}", ORANGE, "solid"),
        ),
    )
    for what, *traces in rows:
        axes = panels.add(f"{what}, {unit}")
        for values, label, colour, dash in traces:
            line = {"color": colour, "width": 1.4, "dash": dash}
            panels.series(axes, t, _broken(before, values), label, line, budget.columns)
    change = before.residual - after.residual
    panels.look(*strongest(before.t_s, change), spans)
    return panels.figure


def _of(channels: Sequence[ChannelData], name: str) -> ChannelData:
    return next(c for c in channels if c.name == name)


def _broken(channel: ChannelData, values: Array) -> Array:
    """Values with a NaN before every new piece of flight, so that no line bridges a gap."""
    starts = np.flatnonzero(np.diff(channel.piece)) + 1
    if values is channel.t_s:  # a time between the pieces
        return np.insert(values, starts, (values[starts - 1] + values[starts]) / 2)
    return np.insert(values, starts, np.nan)
