"""`uavtwin explain`: what a model lacks, as JSON, page, vehicle file and FMUs."""

from collections.abc import Callable, Sequence
from pathlib import Path

from twin.component import unknown_name
from twin.effects import EFFECTS
from twin.errors import TwinError
from twin.explain.estimates import estimates_of
from twin.explain.explanation import Explanation
from twin.explain.result_json import explain_json
from twin.vehicle.file import vehicle_text
from twin.vehicle.file.write import Written, with_effect_sections

from .cli.options import named_numbers
from .export import Choice, export_components
from .output import write_json
from .report.explain import write_explain_report


def write_explanation(
    found: Explanation,
    vehicle: str,
    folder: Path,
    fmus: bool = True,
    progress: Callable[[float], None] = lambda _: None,
) -> list[str]:
    """Write everything that was found.

    Args:
        found: What was found.
        vehicle: Vehicle file, or name of a built-in vehicle, that it was found about.
        folder: To write into.
        fmus: Whether to build the components on which the named effects act.
        progress: Called with the share done.

    Returns:
        Names of the files.
    """
    write_json(folder / "explain.json", explain_json(found))
    write_explain_report(found, folder / "report.html")
    written = ["report.html", "explain.json"]
    if found.added is None:
        return written
    path = folder / "vehicle.toml"
    path.write_text(_new_vehicle(found, vehicle), "utf-8")
    written.append(path.name)
    if fmus:
        choice = Choice(vehicle=str(path))
        rows = export_components(_components(found), choice)(folder, progress)
        written += [str(row["file"]) for row in rows]
    return written


def flight_payloads(texts: Sequence[str], flights: Sequence[str]) -> dict[str, float]:
    """Known mass aboard by flight, kg, of "FLIGHT=KG" texts.

    Raises:
        TwinError: A text is not of that form, or there is no such flight.
    """
    form = f"FLIGHT=KG, e.g. {flights[0]}=0.2"
    payloads = named_numbers(texts, "--payload", form)
    for name, mass_kg in payloads.items():
        if not 0 <= mass_kg < float("inf"):
            raise TwinError(f"--payload {name}={mass_kg:g}: write {form}.")
        if name not in flights:
            raise TwinError(unknown_name("--payload", "flight", name, flights))
    return payloads


def _components(found: Explanation) -> list[str]:
    """Components on which the named effects act."""
    return sorted({EFFECTS[e].component for e in found.effects})


def _new_vehicle(found: Explanation, vehicle: str) -> str:
    """Text of the vehicle file with the named effects in it."""
    assert found.added is not None
    flights = " and ".join(found.flights)
    effects = {}
    for effect in found.effects:
        certainties = {t.number.name: t.ci95 for t in estimates_of(found, effect)}
        effects[effect] = {
            name: Written(value, f"uavtwin explain, {flights}, {_certainty(certainties.get(name))}")
            for name, value in found.added.effects[effect].items()
        }
    return with_effect_sections(vehicle_text(vehicle)[0], found.vehicle, effects)


def _certainty(ci95: tuple[float, float] | None) -> str:
    return "no interval" if ci95 is None else "95 % interval {:.4g} to {:.4g}".format(*ci95)
