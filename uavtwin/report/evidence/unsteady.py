"""What convinces of an effect that changes no mean: spectra, or a reading that stands still."""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from twin.effects import EFFECTS, Lines, NoiseFloor, RandomForce, Repeats
from twin.explain.stochastic.finding import StochasticEffect
from twin.logs import AnyFlight
from twin.physics.sensors.table import SENSORS, Sensor
from twin.residuals.channels import ChannelData
from twin.residuals.spectra import spectrum
from twin.vehicle import Vehicle

from ..drawing.budget import Budget
from ..drawing.panels import Panels
from ..drawing.series import thinned
from ..figures import pretty_unit
from ..page import BLACK, BLUE, GREY, ORANGE, Figure

Array = NDArray[np.float64]
MOST_CHANNELS = 3
AROUND_S = 4.0
"""Before and after the instant from which a reading stands still."""
_MARK = "#c23b66"


def unsteady_figure(
    found: StochasticEffect,
    flight: AnyFlight,
    residuals: Sequence[ChannelData],
    vehicle: Vehicle,
    time: str,
    budget: Budget,
) -> Figure | None:
    """The figure that shows an effect without a mean; None where the flight lacks the readings.

    Args:
        found: The effect.
        flight: As read.
        residuals: Its channels against the model, for a force that is slow.
        vehicle: The model as it stood, whose noise is drawn.
        time: Group of figures whose time axes move together.
        budget: Of the page.
    """
    match EFFECTS[found.effect].observable_as:
        case Repeats():
            return _still(found, flight, time, budget)
        case RandomForce():
            return _slow_force(found, residuals, vehicle, budget)
        case NoiseFloor() | Lines():
            return _spectra(found, flight, vehicle, budget)
    return None


def _still(found: StochasticEffect, flight: AnyFlight, time: str, budget: Budget) -> Figure | None:
    """Readings of a sensor around the instant from which one of them stands still."""
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
    found: StochasticEffect, flight: AnyFlight, vehicle: Vehicle, budget: Budget
) -> Figure | None:
    """Spectra of readings, the noise that the vehicle file says, and the effect."""
    observable_as = EFFECTS[found.effect].observable_as
    names = [c for c in found.channels if flight.has(c)][:MOST_CHANNELS]
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
            at = abs((at + s.rate_hz / 2) % s.rate_hz - s.rate_hz / 2)  # folded, as it is seen
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
    found: StochasticEffect, residuals: Sequence[ChannelData], vehicle: Vehicle, budget: Budget
) -> Figure | None:
    """What is left of the accelerometer: slow, and more than its noise."""
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
    found: StochasticEffect, residuals: Sequence[ChannelData], time: str, budget: Budget
) -> Figure | None:
    """The same over time.

    Args:
        found: A random force.
        residuals: Channels of a flight against the model.
        time: Group of figures whose time axes move together.
        budget: Of the page.
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
    """A panel of a spectrum; lines of rotors are told apart on a linear axis."""
    along: dict[str, object] = {} if linear else {"type": "log", "dtick": 1}
    if last:
        along["title"] = {"text": "frequency, Hz"}
    title = f"{name}: PSD, ({pretty_unit(unit)})²/Hz"
    return panels.add(title, along, {"type": "log", "exponentformat": "power"})
