"""The page that `uavtwin explain` leaves: one sentence, the picture that convinces, the proof."""

from pathlib import Path
from typing import Any

from twin.effects import EFFECTS, Lines, NoiseFloor, RandomForce, Repeats
from twin.explain.estimates import (
    beside_mean,
    estimates_of,
    listed_effects,
    probability_of,
    rivals,
    where_felt,
)
from twin.explain.explanation import Explanation
from twin.explain.model.flight import FlightModel

from .explain_figures import (
    agreement_figure,
    before_after_figure,
    evidence_figure,
    loudest,
)
from .figures import pretty_unit
from .gap import number, percent
from .page import Plot, plot, render
from .panels import Spans, spans_of
from .series import columns_of
from .unsteady_figures import slow_force_over_time, unsteady_figure
from .words import (
    by_prior,
    calibrated_rows,
    certainty,
    claim,
    day_rows,
    instead,
    interval,
    meaning,
    shrink_words,
    shrinking,
    title,
    why_lost,
)

MOST_AFFECTED = 2
"""Channels of an effect that are drawn over time."""
EVIDENCE_SERIES, TIME_SERIES = 20, 30
"""Series of an effect, and of a held-out flight, about, that share the numbers of a page."""
EVIDENCE = (
    "Held-out flight {}. Blue: what the model as it stood leaves of the reading. Black, dashed: "
    "what {} predicts of that. Orange: what is left with it. Where black lies on blue, the effect "
    "is there; where orange lies on zero, nothing else is missing. Light bands hold all samples."
)
UNSTEADY: dict[type, str] = {
    Lines: "Spectra of the readings of {}: black, with a peak where the effect lies; blue, the "
    "noise that the vehicle file allows.",
    NoiseFloor: "Spectra of the readings of {}: the flat part of the black curve is the noise. "
    "Blue: what the vehicle file says; orange: with the effect.",
    RandomForce: "Held-out flights, and {}: what is left of the accelerometer is slow, comes and "
    "goes, and lies above the noise of the vehicle file (blue).",
    Repeats: "Readings of {} around the instant from which one of them repeats itself to the last "
    "bit.",
}
"""How to read the figure of an effect that changes no mean, by how it is seen."""


def write_explain_report(found: Explanation, path: Path) -> None:
    """Write the page; the same findings give the same bytes.

    Args:
        found: What was found.
        path: HTML file to write; an existing one is replaced.
    """
    told = listed_effects(found)
    held = 0 if found.comparison is None else len(found.comparison.model.flights)
    columns = columns_of(EVIDENCE_SERIES * len(told) + TIME_SERIES * held)
    page = render(
        "explain.html.j2",
        {
            "number": number,
            "percent": percent,
            "unit": pretty_unit,
            "shrink_words": shrink_words,
        },
        claim=claim(found),
        found=found,
        shrinking=shrinking(found),
        effects=[_effect(found, e, columns) for e in told],
        before_after=_before_after(found, columns),
        gaps=() if found.comparison is None else found.comparison.gaps,
        alike=[] if found.naming is None else found.naming.resemblances,
        calibrated=calibrated_rows(found),
        days=day_rows(found),
        stable=all(m.stable for m in found.missions),
    )
    path.write_text(page, encoding="utf-8")


def _effect(found: Explanation, effect: str, columns: int) -> dict[str, Any]:
    """One effect as the template reads it."""
    channels, phases = where_felt(found, effect)
    figures, how = _evidence(found, effect, columns)
    return {
        "name": title(effect),
        "meaning": meaning(effect),
        "certainty": certainty(probability_of(found, effect)),
        "numbers": [
            {
                "name": t.number.name,
                "description": t.number.about.description,
                "unit": t.number.about.unit,
                "value": t.value,
                "interval": interval(t.ci95),
                "told_by": by_prior(found, t.prior_share),
            }
            for t in estimates_of(found, effect)
        ],
        "instead": instead(found, effect),
        "channels": channels,
        "phases": phases,
        "figures": figures,
        "how": how,
        "rivals": [
            {
                "name": title(r["name"]),
                "meaning": meaning(r["name"]),
                "certainty": certainty(r["probability"]),
                "why": why_lost(r, found.settings.inference),
            }
            for r in rivals(found, effect)
        ],
    }


def _evidence(found: Explanation, effect: str, columns: int) -> tuple[list[Plot], str]:
    """Figures that convince of an effect, and how to read them; none where there is nothing."""
    acts = next((a for a in found.attributions if a.effect == effect), None)
    name = title(effect)
    if acts is not None and found.comparison is not None:
        after, held = found.comparison.after, found.comparison.model.flights
        i = loudest(acts, after)
        spans, time = _spans(held[i]), _time(i)
        over_time = evidence_figure(acts, after, i, spans, time, columns)
        plots = [plot(f"evidence-{effect}", f"Residuals over time: {name}", over_time)]
        agreement = agreement_figure(acts, after, i)
        if agreement is not None:
            label = f"Residuals over what {name} predicts"
            plots.append(plot(f"agreement-{effect}", label, agreement))
        return plots, EVIDENCE.format(held[i].flight.name, name)
    unsteady = beside_mean(found, effect)
    if unsteady is None:
        return [], ""
    felt = [f for f in found.recorded if any(f.has(c) for c in unsteady.channels)]
    if not felt:
        return [], ""
    residuals = [] if found.comparison is None else found.comparison.after[0]
    vehicle = found.vehicle
    figures = {
        "over-time": slow_force_over_time(unsteady, residuals, columns),
        "seen": unsteady_figure(unsteady, felt[-1], residuals, vehicle, columns),
    }
    if not isinstance(EFFECTS[effect].seen_as, RandomForce):
        del figures["over-time"]
    plots = [plot(f"{effect}-{k}", f"{name}, {k}", f) for k, f in figures.items() if f is not None]
    return plots, UNSTEADY[type(EFFECTS[effect].seen_as)].format(felt[-1].name)


def _spans(flight: FlightModel) -> Spans:
    """Phases of a flight."""
    return spans_of(flight.aligned.inputs.t_s, flight.aligned.phases)


def _time(flight: int) -> str:
    """Group of the figures of a held-out flight, whose time axes move together."""
    return f"held-out-{flight}"


def _before_after(found: Explanation, columns: int) -> list[Plot]:
    """Figures over time of the most affected channels."""
    compared = found.comparison
    if compared is None or not found.values:
        return []
    names = list(dict.fromkeys(c for a in found.attributions for c in a.channels[:MOST_AFFECTED]))
    figures = []
    for name in names[: 2 * MOST_AFFECTED]:
        for i, flight in enumerate(compared.model.flights):
            before, after = (
                next(c for c in channels[i] if c.name == name)
                for channels in (compared.before, compared.after)
            )
            spans = _spans(flight)
            figure = before_after_figure(before, after, spans, _time(i), columns)
            label = f"{name} of {flight.flight.name}, before and after, over time"
            figures.append(plot(f"time-{i}-{name}", label, figure))
    return figures
