"""The numbers of one aircraft, told by normal flights of it, as a result to print and to save."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

from twin.effects import EFFECTS
from twin.errors import TwinError
from twin.explain.calibration import Calibrated
from twin.explain.calibration import calibrate as fitted
from twin.explain.estimates import UNTOLD
from twin.explain.explanation import UNKNOWN_SITE, sited, usable_of
from twin.explain.inference.fit import INTERVAL
from twin.explain.model.numbers import Number
from twin.explain.settings import DEFAULT, SearchSettings
from twin.logs import Flight
from twin.residuals.teacher_forced import drive_warnings
from twin.vehicle import Deviation, Vehicle

from . import vehicles
from .explanation import check_payloads
from .flights import checked_flights
from .report.figures import pretty_unit
from .report.gap import number
from .report.spoken import joined, said
from .report.words import TOLD_BY_PRIOR, interval
from .shown import Shown, TextTable, counted

if TYPE_CHECKING:
    import pandas as pd

DAYS = 3
"""Flights from which on they teach how much days differ."""
_FLY: tuple[tuple[tuple[str, ...], str, str], ...] = (
    (
        ("thrust_scale", "mass_offset"),
        "thrust and mass",
        "climb and sink briskly for half a minute, and weigh the aircraft (sd of body.mass), or "
        "fly once with a known mass aboard (--payload)",
    ),
    (
        ("rotor_drag",),
        "drag",
        "fast straight legs, 10 s each way, forward and sideways",
    ),
    (
        ("yaw_torque_scale", "rotor_inertia_torque", "inertia_error.scale_z"),
        "yaw torque",
        "yaw steps of 90°, quick ones, each way",
    ),
    (
        ("motor_lag", "inertia_error.scale_x", "inertia_error.scale_y", "command_delay"),
        "inertia and lag",
        "sharp roll and pitch doublets, five of each",
    ),
    (("battery_sag",), "battery sag", "one flight that takes the battery from full to low"),
    (("cog_offset",), "centre of mass", "hover for a minute, and turn on the spot meanwhile"),
    (
        ("heading_offset", "mag_soft_iron", "mag_hard_iron"),
        "compass",
        "turn through a full circle in hover, slowly, twice",
    ),
)
"""What to fly where numbers are not told: numbers by how they begin, in words, and how."""

Progress = Callable[[float], None]


@dataclass(frozen=True, repr=False)
class CalibrateResult(Shown):
    """What normal flights say of the numbers of an aircraft.

    Attributes:
        details: Everything that was fitted.
        draft: The vehicle as it stood.
        warnings: What to keep in mind, the worst first.
    """

    details: Calibrated = field(repr=False)
    draft: vehicles.Vehicle
    warnings: tuple[str, ...] = ()

    @property
    def flights(self) -> tuple[str, ...]:
        """Names of the flights that told."""
        assert self.details.vehicle.calibration is not None
        return self.details.vehicle.calibration.flights

    @cached_property
    def vehicle(self) -> vehicles.Vehicle:
        """The vehicle with the numbers of this aircraft and how well they are known together."""
        return calibrated_vehicle(self.details, self.draft)

    @property
    def untold(self) -> tuple[str, ...]:
        """Numbers that these flights do not tell, "effect.number"."""
        return self.details.untold

    @property
    def sentence(self) -> str:
        """How many numbers these flights tell, and the largest in words."""
        told = [n for n in self._numbers() if n.full not in self.untold]
        words = self._words()
        lead = (
            f"{counted(self.flights, 'flight')} of {self.draft.name} "
            f"{'tells' if len(self.flights) == 1 else 'tell'} {len(told)} of its numbers"
        )
        return f"{lead}: {'; '.join(words[:3])}." if words else f"{lead}."

    def _words(self) -> list[str]:
        """A clause for each effect of the aircraft that stands out, the most important first."""
        told: dict[str, dict[str, float]] = {}
        for n in self._numbers():
            change = self._values[n.full] - (n.about.neutral or 0.0)
            clear = abs(change) > max(self._half(n), n.about.smallest)
            if clear and n.full not in self.untold and EFFECTS[n.effect].of_vehicle:
                told.setdefault(n.effect, {})[n.name] = change
        return [said(e, change, since=False) for e, change in told.items()]

    @property
    def _values(self) -> Mapping[str, float]:
        fit = self.details.fit
        return fit.values  # noqa: PD011 (no pandas)

    def _half(self, n: Number) -> float:
        place = self.details.fit.numbers.index(n)
        return float(self.details.fit.half_widths[place])

    def _numbers(self) -> list[Number]:
        """Numbers in the order of what matters: the aircraft, its sensors, its records; of each
        what differs most, in what is worth a name, what is not told last."""
        fit = self.details.fit
        own = [n for n in fit.numbers if not n.shape]

        def size(n: Number) -> float:
            return abs(self._values[n.full] - (n.about.neutral or 0.0)) / n.about.smallest

        most = {n.effect: max(size(m) for m in own if m.effect == n.effect) for n in own}
        untold = {e: all(m.full in self.untold for m in own if m.effect == e) for e in most}
        return sorted(
            own, key=lambda n: (_room(n.effect), untold[n.effect], -most[n.effect], n.effect)
        )

    def frame(self) -> "pd.DataFrame":
        """A row per number, with its 95 % interval."""
        import pandas as pd

        return pd.DataFrame(self.json()["numbers"])

    def numbers_table(self) -> TextTable:
        """The numbers of this aircraft, in words; what flights do not tell says so."""
        rows = []
        for n in self._numbers():
            value, half = self._values[n.full], self._half(n)
            rows.append(
                (
                    n.full,
                    number(value),
                    pretty_unit(n.about.unit) if n.about.unit != "1" else "",
                    interval((value - half, value + half)),
                    TOLD_BY_PRIOR if n.full in self.untold else "",
                    n.about.description,
                )
            )
        return TextTable(("number", "value", "unit", "95 % interval", "", "meaning"), tuple(rows))

    def days_table(self) -> TextTable:
        """How much each number differs between flights, and what stands out of which flight."""
        known = self.details.vehicle.calibration
        assert known is not None
        units = {n.full: n.about.unit for n in self.details.problem.model.numbers}
        rows = []
        for name, sd in known.days.items():
            out = [
                f"{flight} {own[name][0]:+.3g}"
                for flight, own in self.details.days.items()
                if name in own
            ]
            unit = "" if units[name] == "1" else pretty_unit(units[name])
            rows.append((name, number(sd), unit, ", ".join(out)))
        header = ("between flights", "standard deviation", "unit", "stands out")
        return TextTable(header, tuple(rows))

    def fly_next(self) -> tuple[str, ...]:
        """What to fly so that it is told what these flights do not tell."""
        found = []
        for names, what, how in _FLY:
            if any(u.startswith(name) for u in self.untold for name in names):
                found.append(f"{what}: {how}")
        if len(self.flights) < DAYS:
            found.append(f"days: {DAYS} flights or more, on different days")
        return tuple(found)

    def untold_words(self) -> str:
        """What these flights do not tell, by effect."""
        effects = dict.fromkeys(name.partition(".")[0] for name in self.untold)
        return joined([e.replace("_", " ") for e in effects])

    def json(self) -> dict[str, Any]:
        """The same for programs."""
        known = self.details.vehicle.calibration
        assert known is not None
        values, share = self._values, self.details.prior_share
        return {
            "vehicle": self.draft.name,
            "flights": list(self.flights),
            "warnings": list(self.warnings),
            "numbers": [
                {
                    "name": n.full,
                    "value": values[n.full],
                    "unit": n.about.unit,
                    "ci95": [values[n.full] - self._half(n), values[n.full] + self._half(n)],
                    "before": n.now,
                    "prior_share": share.get(n.full, 1.0),
                    "told": n.full not in self.untold,
                }
                for n in self._numbers()
            ],
            "untold": list(self.untold),
            "days": {
                "told": len(self.flights) >= DAYS,
                "sd": dict(known.days),
                "per_flight": {
                    flight: {n: {"difference": v, "sd": sd} for n, (v, sd) in own.items()}
                    for flight, own in self.details.days.items()
                },
            },
            "fly_next": list(self.fly_next()),
        }

    def sections(self) -> Iterable[str | TextTable]:
        """All that `told` says, and the warnings."""
        yield from self.told()
        if self.warnings:
            yield "\n".join(self.warnings)

    def told(self) -> Iterable[str | TextTable]:
        """Sentence, numbers, what is not told, days, what to fly next."""
        yield self.sentence
        yield self.numbers_table()
        if self.untold:
            yield (
                f"These flights do not tell numbers of {self.untold_words()}: they stand as "
                f"expected, or as the file has them."
            )
        days = self.days_table()
        if len(self.flights) < DAYS:
            yield (
                f"{counted(self.flights, 'flight')}: how much days differ stands as is usual; "
                f"{DAYS} flights or more tell it."
            )
        elif days.rows:
            yield days
        if self.fly_next():
            yield "Fly next, for\n" + "\n".join(f"  {line}" for line in self.fly_next())

    def brief(self) -> str:
        """Vehicle, flights, how many numbers."""
        return (
            f"{type(self).__name__}: {self.draft.name}, {counted(self.flights, 'flight')}, "
            f"{counted(self._numbers(), 'number')}"
        )


def calibrate(
    flights: Flight | Sequence[Flight],
    vehicle: Vehicle,
    *,
    payloads: Mapping[str, float] | None = None,
    settings: SearchSettings = DEFAULT,
    indoors: bool | None = None,
    progress: Progress = lambda _: None,
) -> CalibrateResult:
    """Fit the numbers of an aircraft to normal flights of it, all of them together.

    Args:
        flights: Nothing is wrong with the aircraft in them. Three or more also teach how much its
            days differ.
        vehicle: A draft: each number is believed as far as its `sd`, or the word of its source,
            goes.
        payloads: Known mass aboard by the name of a flight, kg.
        settings: The numbers that decide, `docs/reference/settings.md`.
        indoors: Whether all flights were within walls; default: as each flight says, outdoors
            where it does not.
        progress: Called with the share done, 0..1.

    Raises:
        TwinError: An argument is no flight or no vehicle, a payload is of no flight, or no flight
            can be used.
    """
    several = checked_flights(flights, "calibrate")
    draft = vehicles.checked_vehicle(vehicle, "calibrate")
    if not several:
        raise TwinError("calibrate: no flight to calibrate on.")
    names = [f.name for f in several]
    for name in (n for n in dict.fromkeys(names) if names.count(n) > 1):
        raise TwinError(f"{name}: two flights have this name; give each flight once.")
    payloads = dict(payloads or {})
    check_payloads(payloads, names)
    several = tuple(sited(f, indoors) for f in several)
    fit, reasons = usable_of(several, draft, payloads, settings)
    if not fit:
        raise TwinError(f"calibrate: none of the flights can be used: {'; '.join(reasons)}")
    warnings = [f"left out: {reason}" for reason in reasons]
    warnings += [text for f in fit for text in drive_warnings(f, draft)]
    if unknown := [f.name for f in fit if f.indoors is None]:
        warnings.append(UNKNOWN_SITE.format(", ".join(unknown)))
    if draft.calibration is not None:
        again = [n for n in draft.calibration.flights if n in {f.name for f in fit}]
        warnings.append(
            f"{draft.name} was calibrated before, on {', '.join(draft.calibration.flights)}: its "
            f"numbers are believed as far as those flights told them"
            + (f", so {', '.join(again)} count twice; calibrate the draft instead" if again else "")
        )
    found = fitted(fit, draft, progress, payloads, settings.inference)
    return CalibrateResult(found, draft, tuple(warnings))


def calibrated_vehicle(found: Calibrated, draft: vehicles.Vehicle) -> vehicles.Vehicle:
    """The draft with the numbers of an aircraft, each with pedigree and sd.

    An effect that the draft does not have, and that no flight tells, is left out: there is nothing
    to say about it.
    """
    made, fit = vehicles.Vehicle.of(found.vehicle), found.fit
    flights = made.calibration.flights if made.calibration is not None else ()
    sources, deviations = dict(draft.sources), dict(draft.deviations)
    half = {n.full: float(w) for n, w in zip(fit.numbers, fit.half_widths, strict=True)}
    effects = {k: dict(v) for k, v in made.effects.items()}
    for effect in (e for e in fit.effects if e in effects):
        own = [n for n in fit.numbers if n.effect == effect and n.name in effects[effect]]
        if effect not in draft.effects and not any(_says(n, found) for n in own):
            del effects[effect]
            continue
        for name, value in effects[effect].items():
            full, key = f"{effect}.{name}", f"effects.{effect}.{name}"
            known = half.get(full, 0.0) / INTERVAL
            sources[key] = f"uavtwin calibrate, {', '.join(flights)}"
            if found.prior_share.get(full, 1.0) > UNTOLD:
                sources[key] += ", not told by them: as expected"
            deviations.pop(key, None)
            value = float(f"{value:.9g}")
            effects[effect][name] = value
            if known > 0:
                deviations[key] = Deviation.of([float(f"{known:.4g}")], [value])
    return replace(
        made,
        text=draft.text,
        effects=effects,
        sources=sources,
        deviations=deviations,
    )


def _says(n: Number, found: Calibrated) -> bool:
    """Whether a number has anything to say: flights tell it, or it is not what no effect has."""
    away = abs(dict(found.fit.values)[n.full] - (n.about.neutral or 0.0))
    told = found.prior_share.get(n.full, 1.0) <= UNTOLD
    return not n.shape and (told or away > n.about.smallest)


def _room(effect: str) -> int:
    """Of what an effect is: 0 the aircraft, 1 its sensors and its day, 2 its records."""
    about = EFFECTS[effect]
    if not about.of_vehicle:
        return 2
    return 0 if about.component == "airframe" and not about.of_weather else 1
