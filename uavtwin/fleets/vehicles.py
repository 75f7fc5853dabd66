"""Vehicle files of a fleet: of the type what its aircraft share, of each aircraft its own."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from twin.explain.model.numbers import with_effects
from twin.vehicle import Deviation

from ..vehicles import Vehicle
from .fleet_statistics import Spread
from .log_analysis import file_stem

DIGITS = 6
FOLDER = "vehicles"


@dataclass(frozen=True, slots=True)
class Known:
    """A number for a vehicle file.

    Attributes:
        value: In its unit.
        sd: Standard deviation.
        source: What says so.
    """

    value: float
    sd: float
    source: str


Numbers = Mapping[str, Known]
"""By "effect.number"."""


@dataclass
class Files:
    """Numbers of the files.

    Attributes:
        of_type: Of the type; none: nothing is common to it.
        of_aircraft: Of each aircraft.
    """

    of_type: dict[str, Known] = field(default_factory=dict)
    of_aircraft: dict[str, dict[str, Known]] = field(default_factory=dict)


def numbers_of_files(spreads: Sequence[Spread], explained: Sequence[str], typed: bool) -> Files:
    """What goes where.

    An effect of the type goes into the files of all its aircraft: where its own flights determine
    it, as they do, drawn to the type as far as they are unsure; where they do not, as of the type,
    with the spread between aircraft as standard deviation. Other effects are of their aircraft
    alone.

    Args:
        spreads: Numbers over aircraft.
        explained: Aircraft.
        typed: Whether all are of one type; else each has its own numbers alone.
    """
    files = Files(of_aircraft={a: {} for a in explained})
    for s in spreads:
        if not s.of_vehicle:
            continue
        name, common = f"{s.effect}.{s.number}", s.common
        shared = typed and s.of_type
        basis = f"uavtwin fleet, {len(s.aircraft)} of {s.explained} aircraft"
        if shared:
            between = f"{basis}, which differ by {common.between:.3g}"
            files.of_type[name] = Known(common.mean, common.sd, between)
            unsure = float(np.hypot(common.between, common.sd))
            for numbers in files.of_aircraft.values():
                source = f"{basis}: not determined by its own flights, as of the type"
                numbers[name] = Known(common.mean, unsure, source)
        for i, a in enumerate(s.aircraft):
            own = f"uavtwin fleet, named in {a.named} of {a.explained} explanations"
            known = (
                Known(float(common.own[i]), float(common.own_sd[i]), f"{own}; {basis}")
                if shared
                else Known(a.value, a.sd, own)
            )
            files.of_aircraft.setdefault(a.aircraft, {})[name] = known
    return files


def with_numbers(vehicle: Vehicle, numbers: Numbers, name: str) -> Vehicle:
    """A vehicle with numbers of effects, each with source and standard deviation."""
    values = {k: float(f"{n.value:.{DIGITS}g}") for k, n in numbers.items()}
    effects = tuple(dict.fromkeys(k.partition(".")[0] for k in numbers))
    made = Vehicle.of(with_effects(vehicle, effects, values), vehicle.text)
    sources, deviations = dict(vehicle.sources), dict(vehicle.deviations)
    for k, n in numbers.items():
        key = f"effects.{k}"
        sources[key] = n.source
        deviations.pop(key, None)
        sd = float(f"{n.sd:.4g}")
        if sd > 0 and values[k]:
            deviations[key] = Deviation.of([sd], [values[k]])
    return replace(made, name=name, sources=sources, deviations=deviations, calibration=None)


def write_vehicles(
    files: Files, base: Vehicle | None, own: Mapping[str, Vehicle], out: Path
) -> list[str]:
    """Write all files; names of those that were.

    Args:
        files: Numbers.
        base: Vehicle of all aircraft; None: each has its own.
        own: Vehicles by the stem of the name of the file of an aircraft.
        out: Folder of the dataset.
    """
    written = []
    taken = set()
    if base is not None:
        stem = file_stem(base.name)
        taken.add(stem)
        with_numbers(base, files.of_type, base.name).save(out / FOLDER / f"{stem}.toml")
        written.append(f"{stem}.toml")
    for aircraft, numbers in files.of_aircraft.items():
        stem = file_stem(aircraft)
        vehicle = base or own.get(stem)
        if vehicle is None or stem in taken:
            continue
        taken.add(stem)
        with_numbers(vehicle, numbers, vehicle.name).save(out / FOLDER / f"{stem}.toml")
        written.append(f"{stem}.toml")
    return written
