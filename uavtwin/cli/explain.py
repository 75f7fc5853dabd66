"""`uavtwin explain`: find, name, add, show."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from twin.errors import TwinError

from .options import (
    VEHICLE_VARIABLE,
    Csv,
    Force,
    Indoor,
    Json,
    Mcap,
    Out,
    Payload,
    Prints,
    Rebuild,
    Tables,
    TrustVehicle,
    named_numbers,
    needed_vehicle,
    vehicle_named,
)
from .printing import STDERR, progress

if TYPE_CHECKING:
    from twin.logs import AnyFlight

    from ..output import OptionalSteps


def explain(
    flights: Annotated[list[Path], typer.Argument(help="Logs or flight tables, to fit on.")],
    vehicle: Annotated[
        str | None,
        typer.Option(
            help="Vehicle file (TOML), or the name of a built-in vehicle: what does it lack? "
            f"Default: that of {VEHICLE_VARIABLE} in the environment."
        ),
    ] = None,
    since: Annotated[
        str | None,
        typer.Option(
            help="Vehicle file of `uavtwin calibrate`, instead of --vehicle: what has changed "
            "since then?"
        ),
    ] = None,
    holdout: Annotated[
        list[Path] | None,
        typer.Option(
            help="Flights that take no part in the fit and show the gap before and after. "
            "Default: blocks of time of the flights, which is weaker."
        ),
    ] = None,
    payload: Payload = None,
    indoor: Indoor = None,
    rebuild_commands: Rebuild = None,
    trust_vehicle: TrustVehicle = False,
    seed: Annotated[int, typer.Option(min=0, help="Of every bootstrap.")] = 0,
    no_fmus: Annotated[bool, typer.Option("--no-fmus", help="Build no FMUs.")] = False,
    out: Out = Path("explain"),
    csv: Csv = False,
    mcap: Mcap = False,
    tables: Tables = False,
    force: Force = False,
    as_json: Annotated[
        Json,
        Prints(
            "uavtwin.explain_record:ExplainRecord",
            file="explain.json",
            about="Six significant digits. Verdicts: [Explain](../guide/explain.md#verdicts).",
        ),
    ] = False,
) -> None:
    """Name the physical effect that a model lacks, add it, and show that the gap shrinks.

    After an interruption the same command resumes the search.
    """
    given = _one_vehicle(vehicle if since else vehicle_named(vehicle, ""), since)
    from fmus.platforms import DEFAULT, compilers, select_platforms

    from .. import explanation
    from ..accuracy import write_accuracy
    from ..explain_journal import JOURNAL, ExplainJournal, run_key
    from ..output import check_folder
    from ..series.files import chosen_forms
    from ..vehicles import load_vehicle
    from .results import conclude

    check_folder(out, force, JOURNAL)
    forms = chosen_forms(csv, mcap)
    if not no_fmus:
        compilers(select_platforms(DEFAULT))  # a missing one is reported before the search
    model, held = load_vehicle(given), holdout or []
    if since is not None:
        explanation.check_calibrated(model)
    fit, away = _read(flights, held, rebuild_commands, trust_vehicle)
    payloads = flight_payloads(payload or [], [f.name for f in (*fit, *away)])
    decides = [since is not None, payloads, seed, indoor, rebuild_commands, trust_vehicle]
    journal = ExplainJournal(out / JOURNAL, run_key(flights, held, model, decides))
    if journal.note:
        STDERR.print(journal.note)
    with progress("explaining") as step:
        found = explanation.explain(
            fit,
            away,
            model if since is None else None,
            since=None if since is None else model,
            payloads=payloads,
            seed=seed,
            indoors=indoor,
            progress=step,
            checkpoint=journal,
        )
    options = {
        "vehicle" if since is None else "since": Path(given).name,
        "no_fmus": no_fmus,
        "payload": payload or [],
        "rebuild_commands": rebuild_commands,
        "trust_vehicle": trust_vehicle,
        "series": list(forms),
        "indoors": {f.name: site_record(f, indoor) for f in (*fit, *away)},
    }

    def write(folder: Path, steps: "OptionalSteps", step: Callable[[float], None]) -> list[str]:
        """Write page, numbers, vehicle files, FMUs."""
        written = explanation.write_explanation(found.details, folder)
        if not no_fmus:
            written += explanation.write_fmus(found.details, folder, steps, step)
            written += write_accuracy(found.details, away, folder, steps, step, STDERR.print)
        return written

    conclude(
        "explain",
        found,
        out,
        write,
        options,
        [*flights, *held, Path(given)],
        force=force,
        as_json=as_json,
        findings=found.verdict != "nothing",
        flights=[*fit, *away],
        series=found.series(),
        forms=forms,
        tables=tables,
        seed=seed,
        journal=JOURNAL,
    )


def _read(
    flights: Sequence[Path],
    held: Sequence[Path],
    rebuild_commands: bool | None,
    trust_vehicle: bool,
) -> "tuple[list[AnyFlight], list[AnyFlight]]":
    """Flights for the fit, and held-out ones, all read with the same options.

    Raises:
        TwinError: One is in both, or cannot be used.
    """
    from ..flights import open_alike

    for path in held:
        if path.resolve() in {p.resolve() for p in flights}:
            raise TwinError(f"{path}: is a flight of the fit; --holdout takes others.")
    read = open_alike([*flights, *held], rebuild_commands, trust_vehicle)
    return read[: len(flights)], read[len(flights) :]


def _one_vehicle(vehicle: str | None, since: str | None) -> str:
    """The named vehicle.

    Raises:
        TwinError: None was named, or two.
    """
    if not (vehicle and since):
        return needed_vehicle(vehicle or since, "explain")
    raise TwinError(
        "explain: both --vehicle and --since are given. Give --vehicle FILE to ask what its model "
        "lacks, or --since FILE, a file of `uavtwin calibrate`, to ask what has changed since then."
    )


def site_record(flight: "AnyFlight", indoor: bool | None) -> dict[str, bool | str]:
    """Indoors or outdoors for a flight, and the source of that, for `run.json`."""
    from twin.explain.explanation import sited

    site = sited(flight, indoor).site
    if site is None:
        return {"indoors": False, "source": "not known, assumed"}
    return {"indoors": site.indoors, "source": site.source}


def flight_payloads(texts: Sequence[str], flights: Sequence[str]) -> dict[str, float]:
    """Known payload by flight, kg, from "FLIGHT=KG" texts.

    Raises:
        TwinError: A text has another form, or there is no such flight.
    """
    from ..explanation import check_payloads

    form = f"FLIGHT=KG, e.g. {flights[0]}=0.2 or {flights[0]}=200g"
    payloads = named_numbers(texts, "--payload", form, "kg")
    for name, mass_kg in payloads.items():
        if not 0 <= mass_kg < float("inf"):
            raise TwinError(f"--payload {name}={mass_kg:g}: write {form}.")
    check_payloads(payloads, flights)
    return payloads
