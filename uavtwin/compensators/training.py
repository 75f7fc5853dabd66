"""Training: flights to residuals, residuals to a model folder with its page."""

import hashlib
import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from learning.compute import device_named
from learning.data.channels import CHANNELS, UNITS
from learning.data.flights import ResidualFlight, residual_flight, restart_before_s, write_residuals
from learning.model.family import TrainingTask
from learning.model.folder import CURVE, MODEL, WEIGHTS
from learning.model.registry import FamilyRow, check_preset, chosen, family_row
from learning.preset import SEEDS, Protocol
from learning.training.checkpoint import CHECKPOINT
from learning.training.train import fit_model
from twin.errors import TwinError
from twin.formatting import number, percent, pretty_unit
from twin.logs import Flight

from ..flights import check_names
from ..output import check_folder
from ..report.learning_figures import curve_figure
from ..report.page import Plot, plot, render
from ..vehicles import Vehicle

RESIDUALS, REPORT = "training.parquet", "report.html"  # files in the folder of a training
VEHICLE_FILE = "vehicle.toml"
"""In the folder of a trained model: the vehicle whose twin it corrects."""
Progress = Callable[[float], None]


@dataclass(frozen=True, slots=True)
class Plan:
    """What is to be trained.

    Attributes:
        family: To which the preset belongs.
        preset: Of the family's own dataclass.
        protocol: What the model sees.
        horizon: Samples, in `track`; else 0.
        seed: Of everything that is drawn.
        device: Name of that on which a network is trained.
    """

    family: FamilyRow
    preset: Any
    protocol: Protocol
    horizon: int
    seed: int
    device: str

    @property
    def epochs(self) -> int | None:
        """Of the training; None where it is in closed form."""
        return getattr(self.preset, "epochs", None)


def plan_training(
    model: str | None,
    preset: str | None,
    protocol: Protocol,
    horizon: int,
    epochs: int | None,
    seed: int | None,
    device: str,
    out: Path,
    force: bool,
) -> Plan:
    """Check everything that can be wrong before the work begins.

    Raises:
        TwinError: An unknown model, preset or device, one that does not go with the protocol or
            has no epochs, or a folder that holds something else than an interrupted training.
    """
    family, made = chosen(model, preset)
    check_preset(family, made, protocol)
    if epochs is not None:
        if "epochs" not in {f.name for f in fields(made)}:
            raise TwinError(f"preset {made.name} is in closed form and has no epochs; give none")
        made = replace(made, epochs=epochs)
    found = device_named(device)
    check_folder(out, force, CHECKPOINT)
    drawn = SEEDS.get(made.name, 0) if seed is None else seed
    return Plan(family, made, protocol, horizon if protocol == "track" else 0, drawn, found.type)


def prepare(
    plan: Plan,
    flights: Sequence[Flight],
    vehicle: Vehicle,
    rate_hz: float,
    progress: Progress,
) -> list[ResidualFlight]:
    """Residuals of flights against the vehicle, its twin run as the protocol says.

    Raises:
        TwinError: A flight cannot be compared with the vehicle, or two flights have one name.
    """
    check_names(flights)
    before_s = restart_before_s(plan.protocol, plan.horizon, rate_hz)
    residuals = []
    for i, flight in enumerate(flights):

        def share(done: float, i: int = i) -> None:
            progress((i + done) / len(flights))

        residuals.append(residual_flight(flight, vehicle, rate_hz, before_s, share))
    return residuals


def run_training(
    plan: Plan,
    residuals: Sequence[ResidualFlight],
    vehicle: Vehicle,
    out: Path,
    checkpoints: Path,
    progress: Progress,
) -> list[str]:
    """Train, export and write the page.

    Args:
        plan: What is trained.
        residuals: Of the flights.
        vehicle: Whose twin is corrected.
        out: Folder of the results.
        checkpoints: Folder of the checkpoint, from which the training is resumed.
        progress: Called with the share done.

    Returns:
        Names of the files, the page first.
    """
    text = vehicle.toml()
    task = TrainingTask(
        protocol=plan.protocol,
        horizon=plan.horizon,
        seed=plan.seed,
        vehicle=vehicle.name,
        vehicle_sha256=hashlib.sha256(text.encode()).hexdigest(),
        device=plan.device,
        checkpoints=checkpoints,
    )
    model = fit_model(
        residuals, plan.family, plan.preset, task, out, lambda done, _: progress(done)
    )
    exported = plan.family.load().export(model, out)
    (out / VEHICLE_FILE).write_text(text, "utf-8")
    write_residuals(residuals, out / RESIDUALS)
    _write_page(out, residuals)
    names = (REPORT, *exported, WEIGHTS, MODEL, CURVE, VEHICLE_FILE, RESIDUALS)
    return [n for n in names if (out / n).is_file()]


def training_claim(out: Path) -> str:
    """One sentence on a trained model, from its description."""
    about = json.loads((out / MODEL).read_text("utf-8"))
    rows = _validation(about)
    helped = [r for r in rows if r["removed"] > 0]
    task = _task(about)
    if not rows:
        row = family_row(about["family"])
        onnx = "" if row.onnx else "; it has no ONNX form and makes no FMU"
        return (
            f"{task}: {row.meaning}, preset {about['preset']['name']}, fitted to "
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


def _task(about: dict[str, Any]) -> str:
    """Protocol and horizon in words."""
    if about["protocol"] != "track":
        return str(about["protocol"])
    ahead_ms = 1e3 * about["horizon"] / about["rate_hz"]
    return f"track, {about['horizon']} samples ({ahead_ms:g} ms) ahead"


def _validation(about: dict[str, Any]) -> list[dict[str, Any]]:
    """Channels with validation samples: error of the linear prediction and with the network.

    None from a family that keeps no time for validation.
    """
    rows = []
    said = about["metrics"].get("validation_mse", {})
    for channel, unit in zip(CHANNELS, UNITS, strict=True) if said else ():
        errors = said[channel]
        before, after = errors["linear"], errors["with_network"]
        if before > 0:
            removed = 1 - float(np.sqrt(after / before))
            rows.append(
                {
                    "channel": channel,
                    "unit": unit,
                    "before": before,
                    "after": after,
                    "removed": removed,
                }
            )
    return rows


def _write_page(out: Path, residuals: Sequence[ResidualFlight]) -> None:
    about = json.loads((out / MODEL).read_text("utf-8"))
    page = render(
        "training.html.j2",
        {"number": number, "percent": percent, "unit": pretty_unit},
        claim=training_claim(out),
        about=about,
        task=_task(about),
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
    """Figure of the learning curve, None of a model in closed form."""
    if not (out / CURVE).is_file():
        return None
    curve = json.loads((out / CURVE).read_text("utf-8"))
    figure = curve_figure(curve, about["metrics"]["best_epoch"])
    return plot("curve", "Parts of the loss over the epochs of the training", figure)
