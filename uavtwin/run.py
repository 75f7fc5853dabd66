"""Simulations: fly a scenario or run an `.ssp`, with a result to print, plot and report."""

import re
import tempfile
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from msgspec import UNSET, UnsetType
from numpy.typing import NDArray

from cosim.interface import read_interface
from cosim.limits import Limits
from cosim.master import Algorithm, Interrupted, Recording, RunError
from cosim.system import System
from twin.component import unknown_name
from twin.errors import TwinError
from twin.formatting import counted
from twin.vehicle import Vehicle

from .display import PageMixin, TextTable
from .output import output_file, sha256
from .record import Record
from .series.files import Column, Series, write_frame, write_series_mcap
from .simulation import (
    DEFAULT_VEHICLE,
    Scenario,
    asked_scenario,
    run_scenario,
    scenario_system,
    summary,
)
from .vehicles import load_vehicle

if TYPE_CHECKING:
    import pandas as pd

Progress = Callable[[float], None]
_BUILDING = 0.3
"""Approximate share of building in the total work."""
_FIGURES = {
    "tracking_rms_m": ("distance from the setpoint, rms", "m"),
    "tracking_worst_m": ("distance from the setpoint, worst", "m"),
    "tilt_worst_rad": ("tilt, worst", "rad"),
}
"""Figures of a flight in words, by key."""


class RunRecord(Record, frozen=True, kw_only=True):
    """Figures of a flight; those of a system without an aircraft are missing.

    Attributes:
        tracking_rms_m: Distance from the setpoint in the air, rms.
        tracking_worst_m: Largest distance from the setpoint.
        tilt_worst_rad: Largest angle from upright.
        end_pos_m: Last position, NED.
        incomplete: Reason why the run is incomplete; missing where it is complete.
        warnings: Requested settings without effect, such as wind on an aircraft without drag;
            missing without any.
    """

    tracking_rms_m: float | UnsetType = UNSET
    tracking_worst_m: float | UnsetType = UNSET
    tilt_worst_rad: float | UnsetType = UNSET
    end_pos_m: tuple[float, ...] | UnsetType = UNSET
    incomplete: str | UnsetType = UNSET
    warnings: tuple[str, ...] | UnsetType = UNSET


@dataclass(frozen=True, slots=True, repr=False, eq=False)
class Run(PageMixin):
    """Result of a simulation.

    Attributes:
        name: Name of the mission or of the `.ssp`.
        recording: Every output over time.
        units: Unit of each column, "" where it has none.
        facts: Settings of the run, for the page.
        ended: Reason for an early end; None where it is complete.
        fmus: Interface of each FMU, by its name in the system: "FMI 3.0, co-simulation".
        warnings: Requested settings without effect.
    """

    name: str
    recording: Recording
    units: Mapping[str, str]
    facts: Mapping[str, Any] = field(default_factory=dict)
    ended: RunError | Interrupted | None = None
    fmus: Mapping[str, str] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()

    page = "uavtwin.report.simulation"

    @property
    def claim(self) -> str:
        """Outcome in one sentence."""
        duration_s, figures = self.duration_s, summary(self.recording)
        start = "INCOMPLETE, " if self.ended else ""
        if not figures:
            return f"{self.name}: {start}{duration_s:g} s simulated"
        return (
            f"{self.name}: {start}{duration_s:g} s flown, {figures['tracking_rms_m']:.2f} m rms "
            f"from the setpoint, {figures['tracking_worst_m']:.2f} m at worst"
        )

    @property
    def duration_s(self) -> float:
        """Time that it reached."""
        return float(self.recording.time_s[-1]) if len(self.recording.time_s) else 0.0

    def __getitem__(self, column: str) -> NDArray[np.float64]:
        """One output over `recording.time_s`, by its name "part.variable".

        Raises:
            TwinError: There is none of this name.
        """
        if column not in self.recording.names:
            raise TwinError(unknown_name(self.name, "output", column, self.recording.names))
        return self.recording[column]

    def frame(self) -> "pd.DataFrame":
        """Every output, a column each, over the time in s."""
        return self.recording.frame().set_index("time")

    @property
    def record(self) -> RunRecord:
        """Figures of the flight."""
        return RunRecord(
            **summary(self.recording),
            incomplete=self.recording.incomplete or UNSET,
            warnings=tuple(self.warnings) or UNSET,
        )

    def save(self, path: str | Path) -> Path:
        """Write the recording as `.parquet`, `.csv` or `.mcap`; returns its path.

        Units are in the metadata of Parquet's columns and of MCAP; MCAP also has the pose of the
        aircraft.
        """
        with output_file(Path(path)) as file:
            if file.suffix == ".parquet":
                write_frame(self.recording.frame(), self.units, file)
            elif file.suffix == ".mcap":
                write_series_mcap(self._series(), file, _pose(self.recording.names))
            else:
                self.recording.write(file)
        return Path(path)

    def _series(self) -> Series:
        """Every output over time."""
        r = self.recording
        columns = tuple(
            Column(name, self.units.get(name, ""), r.time_s, r[name]) for name in r.names
        )
        why = {"incomplete": r.incomplete} if r.incomplete else {}
        return Series(self.name, columns, {"verb": "simulate", **why})

    def findings(self) -> Iterable[str | TextTable]:
        """The main result and its figures."""
        yield self.claim
        figures = summary(self.recording)
        if figures:
            yield TextTable(
                ("figure", "value", "unit"),
                tuple((text, f"{figures[k]:.3g}", unit) for k, (text, unit) in _FIGURES.items()),
            )

    def brief(self) -> str:
        """Duration and number of outputs."""
        outputs = counted(self.recording.names, "output")
        return f"{type(self).__name__}: {self.name}, {self.duration_s:g} s, {outputs}"


def _pose(names: Sequence[str]) -> tuple[str, ...]:
    """Outputs with position and attitude of the aircraft; none without one."""
    for part in ("airframe", "twin.airframe"):
        wanted = [*(f"{part}.pos_{a}" for a in "xyz"), *(f"{part}.q_{a}" for a in "wxyz")]
        if set(wanted) <= {*names}:
            return tuple(wanted)
    return ()


def simulate(
    scenario: str | Path,
    vehicle: Vehicle | None = None,
    *,
    wind: tuple[float, float, float] = (0.0, 0.0, 0.0),
    gusts: bool = False,
    seed: int = 0,
    controller: str = "lqr",
    effects: Iterable[str] | Mapping[str, Mapping[str, float]] = (),
    starts: Mapping[str, float] | None = None,
    duration: float | None = None,
    step: float | None = None,
    interval: float | None = None,
    algorithm: Algorithm = "jacobi",
    fused: bool = False,
    realtime: float | None = None,
    progress: Progress = lambda _: None,
    trust: str | Path | None = None,
    limits: Limits | None = None,
) -> Run:
    """Fly a scenario, or run an `.ssp`, and record every output.

    Args:
        scenario: Name of a mission (`mission_names()`), or an `.ssp` file, which has its own parts
            and accepts only start values.
        vehicle: Vehicle to fly; default: `copter_default`.
        wind: Velocity of the air, NED, m/s.
        gusts: Whether there is Dryden turbulence.
        seed: Seed of every noise.
        controller: `lqr` or `px4`.
        effects: Effects to switch on: names, or numbers by effect: `{"rotor_drag": {"k_xy_1_s":
            0.4}}`.
        starts: Start values, "part.variable" -> value.
        duration: Simulated time, s; default: of the mission, or of the `.ssp`.
        step: Communication step, s; default: 1 ms, or that of the `.ssp`.
        interval: Time between recorded rows, s; default: about 10 ms.
        algorithm: Co-simulation algorithm, see `cosim.stepping`.
        fused: Whether the twin runs as one FMU.
        realtime: Simulated seconds per second of the clock; None: as fast as possible.
        progress: Called with the completed share, 0..1.
        trust: File of `sha256sum` with hashes of the `.ssp` or all its FMUs, which then run in this
            process; default: those of an `.ssp` run in a separate process.
        limits: Limits of that process; default: 60 s a call, an hour in all, 4 GiB.

    Raises:
        TwinError: An unknown name, or a value outside its range.
        RunError: A `TwinError` as well: an FMU failed during the run; `recording` has the data up
            to then.
    """
    plan = asked_scenario(
        "simulate", scenario, vehicle, wind, gusts, seed, controller, effects, starts, fused
    )
    run = run_plan(
        plan,
        duration,
        progress,
        None if trust is None else Path(trust),
        step_s=step,
        interval_s=interval,
        algorithm=algorithm,
        realtime=realtime,
        limits=limits,
    )
    if run.ended is not None:
        raise run.ended
    return run


def with_model(plan: Scenario, folder: Path) -> Scenario:
    """A scenario with trained models in its twin.

    Args:
        plan: The scenario.
        folder: Folder of `train`: a learned force, a compensator without measurements, or both.

    Raises:
        TwinError: The scenario has its own parts, or a trained model is of another vehicle or needs
            the readings of an aircraft.
    """
    from fmus.compensator import native_model

    from .exports.parts import check_compensator, check_unaided, law_for, learned

    if plan.is_system:
        raise TwinError(f"--model {folder}: {plan.name} brings its own parts. Fly a scenario.")
    vehicle = plan.vehicle or load_vehicle(DEFAULT_VEHICLE)
    network, force = learned(folder)
    if force is not None:
        plan = replace(plan, law=law_for(force, vehicle))
    if network is not None:
        check_unaided(network)
        check_compensator(network, vehicle)
        plan = replace(plan, compensator=native_model(network))
    return plan


def run_plan(
    plan: Scenario,
    duration_s: float | None = None,
    progress: Progress = lambda _: None,
    trust: Path | None = None,
    **how: Any,
) -> Run:
    """Build and run a scenario; `Run.ended` is None if it is complete.

    Args:
        plan: The scenario.
        duration_s: Time from its start on; None: until `stop_s`, or the system's own.
        progress: Called with the share done, 0..1.
        trust: File of hashes, as in `simulate`.
        how: Further arguments of `run_scenario`.

    Raises:
        TwinError: As in `scenario_system` and `run_scenario`.
    """
    with tempfile.TemporaryDirectory(prefix="uavtwin-") as folder:
        warnings: list[str] = []
        system = scenario_system(
            plan, Path(folder), lambda done: progress(_BUILDING * done), warnings.append
        )
        if duration_s is not None:
            how["stop_s"] = system.start_time_s + duration_s
        if trust is not None:
            if not plan.is_system:
                raise TwinError(f"{trust}: scenario {plan.name} has no FMUs to trust, an .ssp has.")
            system = trusted(system, Path(plan.target), trust)
        ended: RunError | Interrupted | None = None
        try:
            recording = run_scenario(
                system, progress=lambda done: progress(_BUILDING + (1 - _BUILDING) * done), **how
            )
        except (RunError, Interrupted) as error:
            if not len(error.recording.time_s):
                raise
            recording, ended = error.recording, error
        units, ways = described(system)
    return Run(plan.name, recording, units, facts_of(plan), ended, ways, tuple(warnings))


def described(system: System) -> tuple[dict[str, str], dict[str, str]]:
    """Units of the outputs, by "slave.variable", and how each FMU is run, by its name."""
    interfaces = {k: read_interface(path) for k, path in system.fmus.items()}
    units = {
        f"{k}.{p.name}": p.unit or ""
        for k, i in interfaces.items()
        for p in i.ports.values()
        if p.causality == "output"
    }
    ways = {k: f"FMI {i.description.fmiVersion}, co-simulation" for k, i in interfaces.items()}
    return units, ways


def facts_of(plan: Scenario) -> dict[str, Any]:
    """Differences from a plain scenario, for the page."""
    facts = {
        "scenario": plan.name,
        "vehicle": None if plan.vehicle is None else plan.vehicle.name,
        "wind": ",".join(f"{v:g}" for v in plan.wind_m_s),
        "gusts": plan.gusts,
        "seed": plan.seed,
        "controller": plan.controller,
        "effects": ", ".join(plan.effects),
        "starts": ", ".join(f"{k}={v:g}" for k, v in plan.starts.items()),
        "fused": plan.fused,
    }
    return {k: v for k, v in facts.items() if v not in (None, "", False)}


_LINE = re.compile(r"\\?([0-9a-f]{64}) [ *].+")
"""Pattern of a line of `sha256sum`."""


def read_hashes(path: Path) -> frozenset[str]:
    """Hashes in a file of `sha256sum`.

    Raises:
        TwinError: It is not readable, a line has another form, or there is none.
    """
    try:
        lines = path.read_text("utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise TwinError(f"{path}: cannot be read: {error}.") from error
    found = [_LINE.fullmatch(line) for line in lines]
    for number, line in enumerate(found, start=1):
        if line is None:
            raise TwinError(f"{path}: line {number} is not of sha256sum; write sha256sum *.fmu.")
    if not found:
        raise TwinError(f"{path}: holds no hash; write it with sha256sum.")
    return frozenset(line[1] for line in found if line)


def trusted(system: System, ssp: Path, hashes: Path) -> System:
    """The system of an `.ssp` marked as trusted: a file of hashes names the `.ssp` or all its FMUs.

    Raises:
        TwinError: The file of hashes is wrong, or an FMU is not in it.
    """
    known = read_hashes(hashes)
    if sha256(ssp) not in known:
        for name, path in system.fmus.items():
            if (found := sha256(path)) not in known:
                raise TwinError(
                    f"{name} ({path.name}): its sha256 {found} is not in {hashes.name}. Add it if "
                    f"you trust the FMU; without --trust all run in a process of their own."
                )
    return replace(system, foreign=False)
