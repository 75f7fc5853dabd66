"""Steps of `uavtwin demo`: built-in flights with a hidden effect, gap, name, vehicle, proof."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from twin.formatting import title
from twin.logs import Flight
from twin.logs.table import write_flight
from twin.representation import ShortRepr
from twin.vehicle import Vehicle

from ..display import TextTable
from ..explain_record import ExplainRecord
from ..explanation import ExplainResult, explain, write_explanation, write_fmus
from ..gaps import GapRecord, GapResult, gap
from ..output import OptionalSteps, write_json
from ..record import Record
from .flights import WAYPOINTS, Hidden, Waypoints, fly, hide

SIDEWAYS: Waypoints = tuple((p, t, (-0.8 * y, 0.8 * x, z)) for p, t, (x, y, z) in WAYPOINTS)
"""The waypoints flown sideways, slightly slower."""
DIAGONAL: Waypoints = (
    ("ground", 1.0, (0.0, 0.0, 0.0)),
    ("takeoff", 3.0, (0.0, 0.0, -2.0)),
    ("hover", 3.0, (0.0, 0.0, -2.0)),
    ("forward", 4.0, (5.0, 4.0, -1.5)),
    ("forward", 3.0, (-1.0, 4.0, -2.5)),
    ("hover", 2.0, (-1.0, 4.0, -2.5)),
    ("forward", 3.0, (0.0, 0.0, -2.0)),
    ("land", 3.0, (0.0, 0.0, 0.0)),
    ("ground", 1.0, (0.0, 0.0, 0.0)),
)
"""Waypoints of a flight with another shape, for holding out."""
FIT = {"fit_1": WAYPOINTS, "fit_2": SIDEWAYS}  # missions of the flights for the fit
HOLDOUT = {"holdout": DIAGONAL}
"""Missions of held-out flights, by name."""


class TruthRecord(Record, frozen=True, kw_only=True):
    """The hidden effect.

    Attributes:
        effect: Name of the effect.
        text: Description in words.
    """

    effect: str
    text: str


class DemoRecord(Record, frozen=True, kw_only=True):
    """Record of a demonstration.

    Attributes:
        gap: Gap of the first flight.
        explain: Result of explain.
        truth: The hidden effect.
        named_rightly: Whether exactly this effect was named.
    """

    gap: GapRecord
    explain: ExplainRecord
    truth: TruthRecord
    named_rightly: bool

    def json(self) -> dict[str, Any]:
        """Record as strict JSON content, `explain` with the digits of `explain.json`."""
        return super().json() | {"explain": self.explain.json()}


@dataclass(frozen=True, slots=True)
class Demo(ShortRepr):
    """Result of the demonstration.

    Attributes:
        hidden: Effect of the plant.
        flights: Flights: two for the fit and one held out.
        gap: Gap of the first flight.
        found: Result of the search.
    """

    hidden: Hidden
    flights: tuple[Flight, ...]
    gap: GapResult
    found: ExplainResult

    @property
    def right(self) -> bool:
        """Whether exactly the hidden effect was named."""
        return self.found.verdict == "named" and self.found.effects == (self.hidden.effect,)

    @property
    def record(self) -> DemoRecord:
        """Record of all numbers."""
        return DemoRecord(
            gap=self.gap.record,
            explain=self.found.record,
            truth=TruthRecord(effect=self.hidden.effect, text=self.hidden.text),
            named_rightly=self.right,
        )

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings of the explanation."""
        return self.found.warnings

    def findings(self) -> Iterable[str | TextTable]:
        """The gap, the explanation, the truth."""
        yield self.gap.claim
        yield from self.found.findings()
        yield self.ending

    @property
    def ending(self) -> str:
        """Text on the hidden effect, and whether it was found."""
        truth = f"hidden in these flights: {self.hidden.text} ({title(self.hidden.effect)})"
        return f"{truth}. The name is {'right' if self.right else 'wrong'}."


def run_demo(
    vehicle: Vehicle, seed: int, progress: Callable[[float], None] = lambda _: None
) -> Demo:
    """Hide an effect, fly, compare, and search for it.

    Args:
        vehicle: Vehicle of the twin.
        seed: Seed of the effect and the sensor noise.
        progress: Called with the completed share.
    """
    hidden = hide(vehicle, seed)
    flights = tuple(
        fly(vehicle, hidden.plant, len(FIT | HOLDOUT) * seed + i, name, waypoints)
        for i, (name, waypoints) in enumerate((FIT | HOLDOUT).items())
    )
    progress(0.1)
    compared = gap(flights[0], vehicle, progress=lambda done: progress(0.1 + 0.2 * done))
    fit, away = flights[: len(FIT)], flights[len(FIT) :]
    found = explain(fit, away, vehicle, seed=seed, progress=lambda done: progress(0.3 + 0.7 * done))
    return Demo(hidden, flights, compared, found)


def write_demo(
    demo: Demo,
    folder: Path,
    steps: OptionalSteps,
    progress: Callable[[float], None] = lambda _: None,
) -> list[str]:
    """Write flights, gap, explanation and the truth; returns the names of the files.

    Args:
        demo: Result of the demonstration.
        folder: Output folder.
        steps: Runs the optional export of FMUs.
        progress: Called with the completed share.
    """
    (folder / "flights").mkdir()
    for flight in demo.flights:
        write_flight(flight, folder / "flights" / f"{flight.name}.parquet")
    write_json(folder / "gap.json", demo.gap.json())
    demo.gap.report(folder / "gap.html")
    hidden = demo.hidden
    write_json(
        folder / "truth.json",
        {"effect": hidden.effect, "text": hidden.text, "named_rightly": demo.right},
    )
    written = write_explanation(demo.found.details, folder)
    written += write_fmus(demo.found.details, folder, steps, progress)
    return [*written, "flights/", "gap.html", "gap.json", "truth.json"]
