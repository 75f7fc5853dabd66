"""Page of `uavtwin explain`: one sentence, the figure with the evidence, the proof."""

from typing import Any

from twin.effects import EFFECTS, RandomForce
from twin.formatting import certainty, number_cells, title

from ..explain_record import EffectRecord
from ..explanation import ExplainResult, alternatives, shrink_words, why_lost
from ..headline import called
from .autopilot import Strip, autopilot_content, strip
from .drawing import Budget, fitted
from .evidence import (
    before_after_figure,
    phases_of,
    steady_evidence,
    time_group,
    unsteady_evidence,
    unsteady_strip,
)
from .overview import flight_spans, overview, overview_plots
from .page import Plot, plot, render

MOST_AFFECTED = 2
"""Largest number of channels of an effect that are drawn over time."""


def page_text(result: ExplainResult) -> str:
    """The page; equal findings give equal bytes."""
    return fitted(lambda budget: _page(result, budget))


def _page(result: ExplainResult, budget: Budget) -> str:
    """Text of the page."""
    record = result.record
    listed = sorted(record.effects, key=lambda e: not EFFECTS[e.name].in_the_air)
    return render(
        "explain.html.j2",
        {"shrink_words": shrink_words},
        found=record,
        claim=record.headline.text,
        got_worse=result.got_worse,
        drive=result.drive,
        hover=result.hover,
        shrinking=result.shrinking,
        effects=[_effect(result, e, budget) for e in listed],
        flight=_flight(result, budget),
        strips=_strips(result),
        before_after=_before_after(result, budget),
        untold=(
            (
                *("doubt", "Calibrated parameters"),
                "Uncertain in the vehicle file and fitted with the effects; the change is within "
                "the uncertainty stated there.",
                result.calibrated_table().rows,
            ),
            (
                *("doubtful", "Also changed in the new vehicle file"),
                "Too doubtful for a name: each number is its mean over all sets of effects, each "
                "counted by its probability, which predicts best.",
                result.doubtful_table().rows,
            ),
        ),
        days=result.days_table().rows,
    )


def _effect(result: ExplainResult, effect: EffectRecord, budget: Budget) -> dict[str, Any]:
    """One effect in the form of the template."""
    figures, how, over = _evidence(result, effect.name, budget)
    descriptions = result.descriptions(effect.name)
    least = result.details.settings.inference.selection.least
    return {
        "name": called(effect.name),
        "meaning": _meaning(effect.name),
        "certainty": certainty(effect.probability),
        "numbers": [
            (
                name,
                descriptions[name],
                *number_cells(p.value, p.unit, p.ci95),
                result.remark(p.prior_share),
            )
            for name, p in effect.parameters.items()
        ],
        "instead": alternatives(effect),
        "channels": effect.channels,
        "phases": effect.phases,
        "figures": figures,
        "how": how,
        "strip": over,
        "rivals": [
            (title(r.name), _meaning(r.name), certainty(r.probability), why_lost(r, least))
            for r in effect.rivals
        ],
    }


def _meaning(effect: str) -> str:
    """Meaning of an effect, in one line; "" without an effect."""
    return EFFECTS[effect].meaning if effect in EFFECTS else ""


def _flight(result: ExplainResult, budget: Budget) -> dict[str, Any]:
    """The last recorded flight, a held-out one if there is any: its track, motors and battery."""
    recorded = result.details.recorded
    if not recorded:
        return {"name": "", "track": [], "logged": None, "view": None}
    flight = recorded[-1]
    phases = flight_spans(flight)
    shown = overview(flight)
    track, logged = overview_plots("flight", shown, phases, budget)
    view = autopilot_content("flight", shown.view, phases, budget)
    return {"name": flight.name, "track": track, "logged": logged, "view": view}


def _strips(result: ExplainResult) -> list[Strip]:
    """Modes and events of the held-out flights, for the time axes of residuals."""
    compared = result.details.comparison
    flights = () if compared is None else compared.model.flights
    strips = [
        strip(time_group(i), f.flight.autopilot, float(f.flight.time_s[-1]))
        for i, f in enumerate(flights)
    ]
    return [s for s in strips if s is not None]


def _evidence(
    result: ExplainResult, effect: str, budget: Budget
) -> tuple[list[Plot], str, Strip | None]:
    """Figures with the evidence for an effect, how to read them, and the strip above them if it is
    not one of the page; no figures without evidence."""
    found = result.details
    acts = next((a for a in found.attributions if a.effect == effect), None)
    compared = found.comparison
    if acts is not None and compared is not None:
        return *steady_evidence(acts, compared.after, compared.model.flights, budget), None
    unsteady = next((u for u in found.stochastic if u.effect == effect), None)
    recorded = [] if unsteady is None else [f for f in found.recorded if f.has(*unsteady.channels)]
    if unsteady is None or not recorded:
        return [], "", None
    if compared is None or not isinstance(EFFECTS[effect].observable_as, RandomForce):
        shown = unsteady_evidence(unsteady, recorded[-1], (), found.vehicle, budget)
        return *shown, unsteady_strip(effect, recorded[-1])
    flight = compared.model.flights[0].flight
    shown = unsteady_evidence(unsteady, flight, compared.after[0], found.vehicle, budget)
    return *shown, unsteady_strip(effect, flight)


def _before_after(result: ExplainResult, budget: Budget) -> list[Plot]:
    """Figures over time of the most affected channels, the one with the largest reduction first."""
    found = result.details
    compared = found.comparison
    if compared is None or not found.values:
        return []
    names = list(dict.fromkeys(c for a in found.attributions for c in a.channels[:MOST_AFFECTED]))
    gap = result.record.gap
    shrunk = {n: gap[n].before / gap[n].after for n in names if n in gap and gap[n].after > 0}
    figures = []
    for name in sorted(names[: 2 * MOST_AFFECTED], key=lambda n: -shrunk.get(n, 0.0)):
        for i, flight in enumerate(compared.model.flights):
            before, after = (
                next(c for c in channels[i] if c.name == name)
                for channels in (compared.before, compared.after)
            )
            spans = phases_of(flight)
            figure = before_after_figure(before, after, spans, time_group(i), budget)
            label = f"{name} of {flight.flight.name}, before and after, over time"
            figures.append(plot(f"time-{name}-{i}", label, figure))
    return figures
