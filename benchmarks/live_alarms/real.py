"""Recorded flights, each held against its aircraft as the other flights tell it.

The numbers are those of `docs/results/real_flights.md`, where every flight is held out in turn:
what `explain` found in the others. Taking them from there costs nothing, and they are public.
"""

import re
from collections.abc import Iterator, Mapping
from pathlib import Path

from twin.effects import EFFECTS, Equation, Shift
from twin.logs import Flight
from twin.vehicle import Vehicle

from ..real_flights.scenarios import SCENARIOS, read

PAGE = Path(__file__).parents[2] / "docs" / "results" / "real_flights.md"
SETS = ("real", "nanobench", "simulated")
"""Scenarios of `benchmarks.real_flights`."""
MICRO = {"µT": 1e-6, "µT/A": 1e-6}
_VALUE = re.compile(r"^(-?[\d.]+(?:e-?\d+)?) \(")


def real_flights(data: Path) -> Iterator[tuple[str, Flight, Vehicle]]:
    """Name, flight, and the vehicle as the other flights have it, of those that are there.

    Args:
        data: Folder of the data.
    """
    for scenario in (s for s in SCENARIOS if s.name in SETS):
        numbers = numbers_without(scenario.title)
        for file in (f for f in scenario.flights if (data / f).is_file()):
            vehicle = with_numbers(scenario.read_vehicle(), numbers[Path(file).stem])
            yield Path(file).stem, read(data, file), vehicle


def numbers_without(section: str) -> dict[str, dict[str, float]]:
    """By flight that was held out, "effect.number" -> value, SI."""
    text = PAGE.read_text("utf-8").split(f"\n## {section}\n", 1)[1].split("\n## ", 1)[0]
    table = text.split("### Which numbers agree\n", 1)[1].split("\n### ", 1)[0]
    lines = [
        [c.strip() for c in x.strip(" |").split(" | ")] for x in table.splitlines() if "|" in x
    ]
    flights = {k: c.removeprefix("without ") for k, c in enumerate(lines[0]) if "without " in c}
    found: dict[str, dict[str, float]] = {name: {} for name in flights.values()}
    for cells in lines[2:]:
        for k, name in flights.items():
            if value := _VALUE.match(cells[k]):
                number = cells[0].strip("`")
                found[name][number] = float(value[1]) * MICRO.get(cells[1], 1.0)
    return found


def with_numbers(vehicle: Vehicle, numbers: Mapping[str, float]) -> Vehicle:
    """The vehicle with effects that change a mean, of the aircraft alone.

    Args:
        vehicle: Of the file.
        numbers: "effect.number" -> value.
    """
    settings: dict[str, dict[str, float]] = {}
    for full, value in numbers.items():
        name, _, number = full.partition(".")
        effect = EFFECTS[name]
        acts = isinstance(effect.observable_as, Shift) and effect.observable_as.acts
        if effect.of_vehicle and (acts or isinstance(effect.observable_as, Equation)):
            settings.setdefault(name, _at_rest(name, vehicle))
            if number in settings[name]:
                settings[name][number] = value
    return vehicle.with_effects(settings)


def _at_rest(effect: str, vehicle: Vehicle) -> dict[str, float]:
    """Every number of an effect at its neutral value; of a shape, its start."""
    sized = [p.sized(vehicle) for p in EFFECTS[effect].parameters]
    return {
        name: p.start if p.neutral is None else p.neutral
        for p in sized
        for name in p.names(vehicle)
    }
