"""The picture that convinces of an effect, and how to read it."""

from collections.abc import Sequence

from twin.effects import EFFECTS, Lines, NoiseFloor, RandomForce, Repeats
from twin.explain.attribution import Attribution
from twin.explain.model.flight import FlightModel
from twin.explain.stochastic.finding import StochasticEffect
from twin.logs import AnyFlight
from twin.residuals.channels import ChannelData
from twin.vehicle import Vehicle

from ..drawing.budget import Budget
from ..drawing.panels import Spans, spans_of
from ..drawing.strip import Strip, strip
from ..page import Plot, plot
from .steady import agreement_figure, evidence_figure, loudest
from .unsteady import slow_force_over_time, unsteady_figure

_STEADY = (
    "Held-out flight {}. Blue: what the model as it stood leaves of the reading. Black, dashed: "
    "what {} predicts of that. Orange: what is left with it. Where black lies on blue, the effect "
    "is there; where orange lies on zero, nothing else is missing. Light bands hold all samples."
)
_CONSTANT = " The effect is nearly constant in this flight: it is seen by how far blue is off zero."
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


def steady_evidence(
    acts: Attribution,
    with_all: Sequence[Sequence[ChannelData]],
    flights: Sequence[FlightModel],
    budget: Budget,
) -> tuple[list[Plot], str]:
    """Figures of an effect that changes a mean, and how to read them.

    Args:
        acts: Where it acts.
        with_all: Channels of each flight with every added effect.
        flights: The same flights.
        budget: Of the page.
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
    found: StochasticEffect,
    flight: AnyFlight,
    residuals: Sequence[ChannelData],
    vehicle: Vehicle,
    budget: Budget,
) -> tuple[list[Plot], str]:
    """The same of an effect that changes no mean.

    Args:
        found: The effect.
        flight: As read.
        residuals: Channels of it against the model.
        vehicle: The model as it stood.
        budget: Of the page.
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
    """Modes, failsafes and messages over the figures of `unsteady_evidence`.

    Args:
        effect: That is shown.
        flight: In which.
    """
    return strip(_unsteady_group(effect), flight.autopilot, float(flight.time_s[-1]))


def _unsteady_group(effect: str) -> str:
    """Group of the figures of an effect without a mean: each looks at a time of its own."""
    return f"unsteady-{effect}"


def phases_of(flight: FlightModel) -> Spans:
    """Phases of a flight."""
    return spans_of(flight.aligned.inputs.t_s, flight.aligned.phases)


def time_group(flight: int) -> str:
    """Group of the figures of a held-out flight, whose time axes move together."""
    return f"held-out-{flight}"
