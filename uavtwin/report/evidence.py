"""Figures that show the evidence for an effect, and how to read them.

For an effect that changes a mean: residuals without and with it over its prediction, flights before
and after. For one that does not: spectra, or a frozen reading.
"""

from collections.abc import Mapping, Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from twin.effects import EFFECTS, Lines, NoiseFloor, RandomForce, Repeats
from twin.formatting import pretty_unit
from twin.logs import AnyFlight, Flight
from twin.physics.sensors.table import SENSORS, Sensor
from twin.residuals.aligned import AlignedFlight
from twin.residuals.channels import BAND_HZ, CHANNEL_HZ, ChannelData
from twin.residuals.gap import spectrum
from twin.vehicle import Vehicle

from .autopilot import Strip, strip
from .drawing import TREND_HZ, Axis, Budget, Panels, Spans, spans_of, thinned
from .page import BLACK, BLUE, GREY, ORANGE, Figure, Plot, plot

_STEADY = (
    "Held-out flight {}. Blue: what the model as it stood leaves of the reading. Black, dashed: "
    "what {} predicts of that. Orange: what is left with it. Where black lies on blue, the effect "
    "is there; where orange lies on zero, nothing else is missing. Light bands hold all samples."
)
"""How to read the figure of an effect that changes a mean."""
_CONSTANT = " The effect is nearly constant in this flight: it is seen by how far blue is off zero."
"""Addition for an effect that is nearly constant."""
_UNSTEADY: dict[type, str] = {
    Lines: "Spectra of the readings of {}: black, with a peak where the effect lies; blue, the "
    "noise that the vehicle file allows.",
    NoiseFloor: "Spectra of the readings of {}: the flat part of the black curve is the noise. "
    "Blue: what the vehicle file says; orange: with the effect.",
    RandomForce: "What is left of the accelerometer of {} is slow, comes and goes, and lies above "
    "the noise of the vehicle file (blue).",
    Repeats: "Readings of {} around the instant from which one of them repeats itself to the last "
    "bit.",
}
"""How to read the figure of other effects, by the way in which they are observed."""


Flights = Sequence[Sequence[ChannelData]]
"""Channels of each flight."""


class SteadyEvidence(Protocol):
    """Evidence for an effect that changes a mean."""

    @property
    def effect(self) -> str:
        """Name of the effect."""

    @property
    def channels(self) -> tuple[str, ...]:
        """Channels on which it acts, the clearest first."""

    @property
    def without(self) -> Flights:
        """Channels of each held-out flight without the effect, all others on."""


class StochasticEvidence(Protocol):
    """Evidence for an effect that changes no mean."""

    @property
    def effect(self) -> str:
        """Name of the effect."""

    @property
    def channels(self) -> tuple[str, ...]:
        """Channels on which it was found."""

    @property
    def values(self) -> Mapping[str, float]:
        """Values of its numbers, by "effect.number"."""


class ModelledFlight(Protocol):
    """A held-out flight on the grid of the twin."""

    @property
    def flight(self) -> Flight:
        """Flight as read."""

    @property
    def aligned(self) -> AlignedFlight:
        """Flight on the grid."""


def steady_evidence(
    acts: SteadyEvidence,
    with_all: Sequence[Sequence[ChannelData]],
    flights: Sequence[ModelledFlight],
    budget: Budget,
) -> tuple[list[Plot], str]:
    """Figures of an effect that changes a mean, and how to read them.

    Args:
        acts: Effect with its channels.
        with_all: Channels of each flight with every added effect.
        flights: The same flights.
        budget: Budget of the page.
    """
    i = loudest(acts, with_all)
    name = acts.effect.replace("_", " ")
    spans, time = phases_of(flights[i]), time_group(i)
    over_time = evidence_figure(acts, with_all, i, spans, time, budget)
    plots = [plot(f"evidence-{acts.effect}", f"Residuals over time: {name}", over_time)]
    text = _STEADY.format(flights[i].flight.name, name)
    agreement = agreement_figure(acts, with_all, i)
    if agreement is None:
        return plots, text + _CONSTANT
    label = f"Residuals over what {name} predicts"
    return [*plots, plot(f"agreement-{acts.effect}", label, agreement)], text


def unsteady_evidence(
    found: StochasticEvidence,
    flight: AnyFlight,
    residuals: Sequence[ChannelData],
    vehicle: Vehicle,
    budget: Budget,
) -> tuple[list[Plot], str]:
    """Figures of an effect that changes no mean, and how to read them.

    Args:
        found: Effect with its numbers.
        flight: Flight as read.
        residuals: Channels of the flight relative to the model.
        vehicle: Model before the effect was added.
        budget: Budget of the page.
    """
    kind, name = type(EFFECTS[found.effect].observable_as), found.effect.replace("_", " ")
    time = _unsteady_group(found.effect)
    figures = [unsteady_figure(found, flight, residuals, vehicle, time, budget)]
    if kind is RandomForce:
        figures.insert(0, slow_force_over_time(found, residuals, time, budget))
    plots = [
        plot(f"evidence-{found.effect}-{i}", f"What shows {name}", figure)
        for i, figure in enumerate(figures)
        if figure is not None
    ]
    return plots, _UNSTEADY[kind].format(flight.name) if plots else ""


def unsteady_strip(effect: str, flight: AnyFlight) -> Strip | None:
    """Modes, failsafes and messages above the figures of `unsteady_evidence`.

    Args:
        effect: Name of the effect.
        flight: Flight with the records.
    """
    return strip(_unsteady_group(effect), flight.autopilot, float(flight.time_s[-1]))


def _unsteady_group(effect: str) -> str:
    """Group of the figures of an effect without a mean: each shows another span of time."""
    return f"unsteady-{effect}"


def phases_of(flight: ModelledFlight) -> Spans:
    """Phases of a flight."""
    return spans_of(flight.aligned.inputs.t_s, flight.aligned.phases)


def time_group(flight: int) -> str:
    """Group of the figures of a held-out flight, with common time axes."""
    return f"held-out-{flight}"


Array = NDArray[np.float64]
MOST_CHANNELS = 2
"""Largest number of drawn channels."""
MOST_DOTS = 600
"""Largest number of points in a scatter plot; more would overlap."""
LONGEST_S = 20.0
"""Longest span of a flight that is shown at first; of a longer one the part with the strongest
effect."""
HELD = 0.95
"""Share of an effect's prediction below the cut-off of its curves."""
VARIES = 0.25
"""Spread of an effect's prediction over its size, below which it is constant: a scatter plot would
be one dot."""
STANDS_OUT = 0.5
"""Spread of an effect's prediction over that of the residual, below which a scatter plot is
noise."""
BEFORE, AFTER, PREDICTED = "model as it stood", "model with the effect", "what the effect predicts"
"""Names of the curves."""


def evidence_figure(
    acts: SteadyEvidence, with_all: Flights, flight: int, spans: Spans, time: str, budget: Budget
) -> Figure:
    """Residual without and with an effect over its prediction, over time.

    A constant effect appears as a residual that is off zero throughout.

    Args:
        acts: Effect with its channels.
        with_all: Channels of each flight with every added effect.
        flight: Number of the flight to show.
        spans: Phases of the flight.
        time: Group of figures with common time axes.
        budget: Budget of the page.
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


def agreement_figure(acts: SteadyEvidence, with_all: Flights, flight: int) -> Figure | None:
    """Residual without and with an effect over its prediction; None where that is constant, or
    small relative to noise.

    Args:
        acts: Effect with its channels.
        with_all: Channels of each flight with every added effect.
        flight: Number of the flight to show.
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
    """Whether the prediction of an effect varies, and by more than noise."""
    low, high = np.percentile(predicted, [2.5, 97.5])
    more = bool(high - low > VARIES * np.abs(predicted).max(initial=0.0))
    return more and bool(np.std(predicted) > STANDS_OUT * np.std(left))


def _varies_on(acts: SteadyEvidence, with_all: Flights, flight: int, name: str) -> bool:
    without, complete = (_of(f[flight], name) for f in (acts.without, with_all))
    return varies(without.residual - complete.residual, complete.residual)


def strongest(t_s: Array, predicted: Array) -> tuple[float, float]:
    """The span of time to show: all of it, or the `LONGEST_S` with the strongest effect."""
    start, end = float(t_s[0]), float(t_s[-1])
    if end - start <= 1.3 * LONGEST_S:
        return start, end
    power = np.concatenate([[0.0], np.cumsum((predicted - np.mean(predicted)) ** 2)])
    behind = np.searchsorted(t_s, t_s + LONGEST_S)
    first = int(np.argmax(power[behind] - power[:-1]))
    first = int(np.searchsorted(t_s, min(float(t_s[first]), end - LONGEST_S)))
    return float(t_s[first]), float(t_s[first]) + LONGEST_S


def loudest(acts: SteadyEvidence, with_all: Flights) -> int:
    """The flight with the strongest effect on its clearest channel."""
    sizes = []
    for a, b in zip(acts.without, with_all, strict=True):
        one, two = (_of(f, acts.channels[0]) for f in (a, b))
        sizes.append(float(np.mean((one.residual - two.residual) ** 2)))
    return int(np.argmax(sizes))


def _reaches_hz(t_s: Array, predicted: Array) -> float:
    """Frequency below which most of a prediction's variation is; limited to the range of the
    curves' cut-off."""
    s = spectrum(t_s, predicted)
    total = np.cumsum(s.psd)
    if not len(total) or total[-1] <= 0:
        return TREND_HZ
    reach = float(s.f_hz[int(np.searchsorted(total, HELD * total[-1]))])
    return float(np.clip(1.5 * reach, TREND_HZ, min(BAND_HZ, 0.4 * CHANNEL_HZ)))


def before_after_figure(
    before: ChannelData, after: ChannelData, spans: Spans, time: str, budget: Budget
) -> Figure:
    """Measured, both models, and both residuals, over time.

    Args:
        before: Channel of a held-out flight with the model before.
        after: Channel with the effects added.
        spans: Phases of the flight.
        time: Group of figures with common time axes.
        budget: Budget of the page.
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
    """Values with a NaN before every new piece of flight, so that no line crosses a gap."""
    starts = np.flatnonzero(np.diff(channel.piece)) + 1
    if values is channel.t_s:  # a time between the pieces
        return np.insert(values, starts, (values[starts - 1] + values[starts]) / 2)
    return np.insert(values, starts, np.nan)


MOST_UNSTEADY = 3
"""Largest number of drawn channels for an effect without a mean."""
AROUND_S = 4.0
"""Time before and after the instant from which a reading is frozen."""


def unsteady_figure(
    found: StochasticEvidence,
    flight: AnyFlight,
    residuals: Sequence[ChannelData],
    vehicle: Vehicle,
    time: str,
    budget: Budget,
) -> Figure | None:
    """The figure that shows an effect without a mean; None where the flight lacks the readings.

    Args:
        found: Effect with its numbers.
        flight: Flight as read.
        residuals: Channels of the flight relative to the model, for a slow force.
        vehicle: Model before the effect was added, whose noise is drawn.
        time: Group of figures with common time axes.
        budget: Budget of the page.
    """
    match EFFECTS[found.effect].observable_as:
        case Repeats():
            return _still(found, flight, time, budget)
        case RandomForce():
            return _slow_force(found, residuals, vehicle, budget)
        case NoiseFloor() | Lines():
            return _spectra(found, flight, vehicle, budget)
    return None


def _still(
    found: StochasticEvidence, flight: AnyFlight, time: str, budget: Budget
) -> Figure | None:
    """Readings of a sensor around the instant from which one of them is frozen."""
    channel = found.channels[0]
    sensor = next(s for s in SENSORS if channel in s.columns)
    if not flight.has(channel):
        return None
    t, values = flight.signal([channel])
    since = next((v for k, v in found.values.items() if k.endswith("time_s")), float(t[0]))
    panels = Panels((150,) * len(sensor.columns), time)
    for column in sensor.columns:
        stuck = column == channel
        axes = panels.add(f"{column}, {pretty_unit(sensor.unit)}")
        if not flight.has(column):
            continue
        t, values = flight.signal([column])
        near = np.abs(t - since) <= AROUND_S
        line = {"color": ORANGE if stuck else BLACK, "width": 1.3}
        name = "stands still" if stuck else "the other axes go on"
        panels.line(axes, *thinned(t[near], values[near, 0], budget.columns), name, line)
    panels.look(since - AROUND_S, since + AROUND_S, (("still", since, since + AROUND_S),))
    return panels.figure


def _spectra(
    found: StochasticEvidence, flight: AnyFlight, vehicle: Vehicle, budget: Budget
) -> Figure | None:
    """Spectra of readings, the noise in the vehicle file, and the effect."""
    observable_as = EFFECTS[found.effect].observable_as
    names = [c for c in found.channels if flight.has(c)][:MOST_UNSTEADY]
    if not names:
        return None
    own = {k.partition(".")[2]: v for k, v in found.values.items()}
    panels = Panels((170,) * len(names))
    for i, name in enumerate(names):
        sensor = next(s for s in SENSORS if name in s.columns)
        t, values = flight.signal([name])
        s = spectrum(t, values[:, 0])
        linear = isinstance(observable_as, Lines)
        axes = _density(panels, name, sensor.unit, i == len(names) - 1, linear)
        keep = (s.f_hz > 0) & (s.psd > 0)
        if not keep.any():
            continue
        scale = s.f_hz[keep] if linear else np.log10(s.f_hz[keep])
        f, psd = thinned(scale, np.log10(s.psd[keep]), budget.spectrum)
        f = f if linear else 10**f
        panels.line(axes, f, 10**psd, "measured", {"color": BLACK, "width": 1.3})
        ends = f[[0, -1]]
        stated = sensor.noise(vehicle)
        noise = {"color": BLUE, "width": 1.8, "dash": "dash"}
        if stated > 0:
            level = np.full(2, 2 * stated**2 / s.rate_hz)
            panels.line(axes, ends, level, "noise of the vehicle file", noise)
        if isinstance(observable_as, NoiseFloor):
            with_it = np.full(2, 2 * _noise(stated, own, observable_as, sensor) ** 2 / s.rate_hz)
            effect = {"color": ORANGE, "width": 1.8}
            panels.line(axes, ends, with_it, "noise with the effect", effect)
        if isinstance(observable_as, Lines):
            at = own[observable_as.frequency]
            at = abs((at + s.rate_hz / 2) % s.rate_hz - s.rate_hz / 2)  # aliased, as it is observed
            reach = 10 ** np.array([psd.min(), psd.max()])
            line = {"color": ORANGE, "width": 1.8, "dash": "dot"}
            panels.line(axes, np.full(2, at), reach, "where the effect lies in hover", line)
    return panels.figure


def _noise(
    stated: float, own: Mapping[str, float], observable_as: NoiseFloor, sensor: Sensor
) -> float:
    """Standard deviation of a reading with the effect."""
    further = own.get(observable_as.further.get(sensor.signal, ""), 0.0)
    return float(np.hypot(stated * own.get(observable_as.scale, 1.0), further))


def _slow_force(
    found: StochasticEvidence, residuals: Sequence[ChannelData], vehicle: Vehicle, budget: Budget
) -> Figure | None:
    """Residual of the accelerometer: slow, and larger than its noise."""
    names = [c for c in residuals if c.name in found.channels]
    if not names:
        return None
    panels = Panels((170,) * len(names))
    for i, channel in enumerate(names):
        sensor = next(s for s in SENSORS if channel.name in s.columns)
        s = spectrum(channel.t_s, channel.residual)
        keep = (s.f_hz > 0) & (s.psd > 0) & (s.f_hz < 15)
        axes = _density(panels, f"residual of {channel.name}", channel.unit, i == len(names) - 1)
        f, psd = thinned(np.log10(s.f_hz[keep]), np.log10(s.psd[keep]), budget.spectrum)
        panels.line(axes, 10**f, 10**psd, "residual", {"color": GREY, "width": 1.5})
        stated = sensor.noise(vehicle)
        if stated > 0:
            level = np.full(2, 2 * stated**2 / 200.0)
            line = {"color": BLUE, "width": 1.8, "dash": "dash"}
            panels.line(axes, 10 ** f[[0, -1]], level, "noise of the vehicle file", line)
    return panels.figure


def slow_force_over_time(
    found: StochasticEvidence, residuals: Sequence[ChannelData], time: str, budget: Budget
) -> Figure | None:
    """Residual of the accelerometer over time.

    Args:
        found: Effect of a random force.
        residuals: Channels of a flight relative to the model.
        time: Group of figures with common time axes.
        budget: Budget of the page.
    """
    names = [c for c in residuals if c.name in found.channels]
    if not names:
        return None
    panels = Panels((170,) * len(names), time)
    for channel in names:
        axes = panels.add(f"residual of {channel.name}, {pretty_unit(channel.unit)}")
        line = {"color": GREY, "width": 1.4}
        panels.series(axes, channel.t_s, channel.residual, "residual", line, budget.columns)
    panels.look(float(names[0].t_s[0]), float(names[0].t_s[-1]), ())
    return panels.figure


def _density(panels: Panels, name: str, unit: str, last: bool, linear: bool = False) -> str:
    """Add the panel of a spectrum; on a linear axis lines of rotors are distinct."""
    along: dict[str, object] = {} if linear else {"type": "log", "dtick": 1}
    if last:
        along["title"] = {"text": "frequency, Hz"}
    title = f"{name}: PSD, ({pretty_unit(unit)})²/Hz"
    return panels.add(title, along, {"type": "log", "exponentformat": "power"})
