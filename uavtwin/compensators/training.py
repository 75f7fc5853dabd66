"""Training: from flights to residuals, from residuals to a model folder with its report."""

import hashlib
import json
import tempfile
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import msgspec
import numpy as np

from fmus.compensator import NetworkFile, read_network
from learning.compute import device_named
from learning.data.channels import CHANNELS, UNITS
from learning.data.flights import ResidualFlight, residuals_of, restart_before_s, write_residuals
from learning.force.model import copy_force
from learning.model.compensator import Compensator
from learning.model.family import Family, TrainedModel, TrainingTask
from learning.model.folder import CURVE, MODEL, WEIGHTS, save
from learning.model.registry import chosen, family_named, preset_named
from learning.preset import SEEDS, Protocol
from learning.training.checkpoint import CHECKPOINT
from learning.training.train import fit_model
from twin.errors import TwinError
from twin.formatting import number, percent
from twin.logs import Flight
from twin.residuals.teacher_forced import choose_drive

from ..exports.parts import learned_force
from ..flights import check_names
from ..model_card import validation_errors
from ..output import check_folder
from ..report.learning_figures import curve_figure
from ..report.page import Plot, plot, render
from ..vehicles import Vehicle
from .in_use import Corrections, InUseRecord, UsedFlight, driven_fmu, harmful, record_of

if TYPE_CHECKING:
    from ..learned import Wanted

RESIDUALS, REPORT = "training.parquet", "report.html"  # files in the folder of a training
IN_USE = "in_use.json"
"""File in that folder: errors with the corrections in the exported twin."""
VEHICLE_FILE = "vehicle.toml"
"""File in the folder of a trained model: the vehicle whose twin it corrects."""
Progress = Callable[[float], None]


@dataclass(frozen=True, slots=True)
class Plan:
    """Settings of a training.

    Attributes:
        family: Model family.
        preset: Preset, a dataclass of the family.
        task: Training task, still without its vehicle.
        law: Folder of a learned force that the twin has, in `free`; None: it has none.
    """

    family: Family[Any, Any]
    preset: Any
    task: TrainingTask
    law: Path | None = None

    @property
    def epochs(self) -> int | None:
        """Number of training epochs; None for a closed-form solution."""
        network = getattr(self.preset, "network", True)
        return getattr(self.preset, "epochs", None) if network else None


def plan_training(wanted: "Wanted", out: Path, force: bool) -> Plan:
    """Check all options before the work begins.

    Raises:
        TwinError: The model, preset or device is unknown, is not allowed with the protocol or has
            no epochs, the law cannot be used, or the folder holds other files than an interrupted
            training.
    """
    model, protocol, epochs = wanted.model, cast("Protocol", wanted.protocol), wanted.epochs
    if model is None and wanted.preset is None and epochs is None and protocol == "free":
        model = "linear"  # no network was better on flights left out
    family, made = chosen(model, wanted.preset, protocol)
    law = wanted.law
    if law is not None and (protocol != "free" or not family.onnx):
        raise TwinError(f"law {law}: acts in the exported twin, which protocol free corrects alone")
    device = device_named(wanted.device).type
    check_folder(out, force, CHECKPOINT)
    drawn = SEEDS.get(made.name, 0) if wanted.seed is None else wanted.seed
    ahead = wanted.horizon if protocol == "track" else 0
    plan = Plan(family, made, TrainingTask(protocol, ahead, drawn, device=device), law)
    if epochs is not None:
        if plan.epochs is None:
            raise TwinError(f"preset {made.name} is in closed form and has no epochs; give none")
        plan = replace(plan, preset=replace(plan.preset, epochs=epochs))
    return plan


IMU_RATES_HZ = (50.0, 1000.0)
"""Lowest and highest IMU rate, Hz, of a compensator where no rate is given."""
_COMPARED = 0.1  # approximate share of the work done when the flights are compared
MOST_FOLDS = 3
"""Maximum number of cross-validation folds (groups of flights)."""


def imu_rate_hz(flights: Sequence[Flight]) -> float:
    """Default rate of a compensator, Hz: that of the slowest gyroscope, rounded to 1000 Hz over an
    integer; 100 Hz where none was logged."""
    times = [f.signal(["gyro_x"])[0] for f in flights if f.has("gyro_x")]
    slowest = min((1 / float(np.median(np.diff(t))) for t in times if len(t) > 1), default=100.0)
    return 1000 / round(1000 / float(np.clip(slowest, *IMU_RATES_HZ)))


def run_training(
    plan: Plan,
    flights: Sequence[Flight],
    vehicle: Vehicle,
    rate_hz: float,
    out: Path,
    checkpoints: Path,
    progress: Progress,
) -> list[str]:
    """Train on residuals of flights, export, evaluate the exported twin and write the report.

    Args:
        plan: Settings of the training.
        flights: Training flights.
        vehicle: Vehicle whose twin is corrected.
        rate_hz: Sample rate, 1000 Hz over an integer.
        out: Folder of the results.
        checkpoints: Folder of the checkpoint, from which the training resumes.
        progress: Called with the share done, 0..1.

    Returns:
        Names of the files, the report first.

    Raises:
        TwinError: A flight cannot be compared with the vehicle, or two flights have one name.
    """
    check_names(flights)
    before_s = restart_before_s(plan.task.protocol, plan.task.horizon, rate_hz)
    compared = residuals_of(
        flights, vehicle, rate_hz, before_s, lambda done: progress(_COMPARED * done)
    )
    residuals, used = compared, []
    law = None if plan.law is None else learned_force(plan.law)
    driven = partial(driven_fmu, vehicle, choose_drive(flights[0], vehicle), law=law)
    if plan.task.protocol == "free" and plan.family.onnx:
        used = [UsedFlight(flight, vehicle) for flight in flights]
        with driven() as fmu:
            residuals = tuple(one.residuals(fmu, rate_hz) for one in used)
    text = vehicle.toml()
    task = replace(
        plan.task,
        vehicle=vehicle.name,
        vehicle_sha256=hashlib.sha256(text.encode()).hexdigest(),
        checkpoints=checkpoints,
    )

    def share(done: float, left_s: float | None) -> None:
        progress(_COMPARED + (1 - _COMPARED) * done)

    model = fit_model(residuals, plan.family, plan.preset, task, out, share)
    if used and isinstance(model, Compensator):
        in_use = _gated(model, residuals, used, driven, task, out)
        save(model, out)
        (out / IN_USE).write_text(json.dumps(in_use.json(), indent=1) + "\n", "utf-8")
    exported = plan.family.export(model, out)
    (out / VEHICLE_FILE).write_text(text, "utf-8")
    write_residuals(compared, out / RESIDUALS)
    _write_page(out, compared)
    names = (REPORT, *exported, WEIGHTS, MODEL, CURVE, VEHICLE_FILE, RESIDUALS, IN_USE)
    own = [] if plan.law is None else copy_force(plan.law, out)
    return [*(n for n in names if (out / n).is_file()), *own]


def _gated(
    model: Compensator,
    residuals: Sequence[ResidualFlight],
    used: Sequence[UsedFlight],
    driven: Callable[[NetworkFile], AbstractContextManager[Path]],
    task: TrainingTask,
    out: Path,
) -> InUseRecord:
    """Disable the channels in which the correction does not reduce the error of the exported twin.

    Cross-validation over flights with the linear prediction; a single flight is corrected by the
    model itself.

    Args:
        model: Trained model; it is changed.
        residuals: Residuals of the flights.
        used: The same flights, along which the exported twin is evaluated.
        driven: Context with the FMU of the driven twin with a compensator.
        task: Task of the training.
        out: Folder for temporary files.

    Returns:
        Errors with the corrections that remain enabled.
    """
    n, found = len(used), list[Corrections]()
    for k in range(min(n, MOST_FOLDS)):
        others = [r for i, r in enumerate(residuals) if i % MOST_FOLDS != k]
        left_out = [f for i, f in enumerate(used) if i % MOST_FOLDS == k]
        with tempfile.TemporaryDirectory(dir=out) as place:
            taught: TrainedModel = model
            if others:
                family, preset = preset_named("linear")
                alone = replace(task, checkpoints=None)
                taught = fit_model(others, family, preset, alone, Path(place))
            family_named(taught.family).export(taught, Path(place))
            with driven(read_network(Path(place))) as fmu:
                found += [flight.corrections(fmu) for flight in left_out]
    shut = harmful([record_of([f.beyond_offsets()], "left out") for f in found])
    model.shut([CHANNELS.index(c) for c in shut])
    return record_of(found, "left out" if n > 1 else "same", shut)


def in_use_of(out: Path) -> InUseRecord | None:
    """Errors with the corrections of a trained model in use; None where that was not evaluated."""
    if not (out / IN_USE).is_file():
        return None
    return msgspec.json.decode((out / IN_USE).read_bytes(), type=InUseRecord)


def training_claim(out: Path) -> str:
    """Summary sentence of a trained model, from its description."""
    about = json.loads((out / MODEL).read_text("utf-8"))
    if in_use := in_use_of(out):
        return f"{_task(about)}: {in_use.claim}."
    rows = _validation(about)
    helped = [r for r in rows if r["removed"] > 0]
    task = _task(about)
    if not rows:
        family = family_named(about["family"])
        onnx = "" if family.onnx else "; it has no ONNX form and makes no FMU"
        return (
            f"{task}: {family.meaning}, preset {about['preset']['name']}, fitted to "
            f"{len(about['flights'])} flights; `uavtwin evaluate` measures it on others{onnx}."
        )
    if about["protocol"] == "reconstruct":
        left = float(np.mean([r["after"] for r in rows])) if rows else float("nan")
        return (
            f"{task}: mean square error {number(left)} in standardised units on validation time; "
            "it sees the measurement it repeats, so the raw residual would score 0."
        )
    if not helped:
        return (
            f"{task}: on validation time the network adds nothing to the linear prediction; "
            "its gates are shut."
        )
    gain = percent(float(np.median([r["removed"] for r in helped])))
    return (
        f"{task}: on validation time the network lowers the error of the linear prediction in "
        f"{len(helped)} of {len(rows)} channels, by {gain} at the median; in the others its "
        "gates are shut."
    )


def task_text(protocol: str, horizon: int, rate_hz: float) -> str:
    """Protocol and horizon as text."""
    if protocol != "track":
        return protocol
    return f"track, {horizon} samples ({1e3 * horizon / rate_hz:g} ms) ahead"


def _task(about: dict[str, Any]) -> str:
    return task_text(about["protocol"], about["horizon"], about["rate_hz"])


def _validation(about: dict[str, Any]) -> list[dict[str, Any]]:
    """Channels with validation samples: error of the linear prediction, and with the network."""
    units = dict(zip(CHANNELS, UNITS, strict=True))
    return [
        {
            "channel": channel,
            "unit": units[channel],
            "before": errors["linear"],
            "after": errors["with_network"],
            "removed": 1 - float(np.sqrt(errors["with_network"] / errors["linear"])),
        }
        for channel, errors in validation_errors(about).items()
    ]


def _write_page(out: Path, residuals: Sequence[ResidualFlight]) -> None:
    about = json.loads((out / MODEL).read_text("utf-8"))
    page = render(
        "training.html.j2",
        claim=training_claim(out),
        about=about,
        task=_task(about),
        in_use=in_use_of(out),
        channels=_validation(about),
        flights=[
            {
                "name": f.name,
                "samples": int(f.fresh.any(axis=1).sum()),
                "seconds": sum(b - a for a, b in f.spans) / f.rate_hz,
                "notes": f.notes,
            }
            for f in residuals
        ],
        figure=_curve(out, about),
    )
    (out / REPORT).write_text(page, encoding="utf-8")


def _curve(out: Path, about: dict[str, Any]) -> Plot | None:
    """Figure of the learning curve; None for a closed-form solution."""
    if not (out / CURVE).is_file():
        return None
    curve = json.loads((out / CURVE).read_text("utf-8"))
    figure = curve_figure(curve, about["metrics"]["best_epoch"])
    return plot("curve", "Parts of the loss over the epochs of the training", figure)
