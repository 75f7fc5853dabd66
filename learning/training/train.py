"""Training: from flights to a compensator; the same seed gives the same bytes.

An interrupted training resumes from its last checkpoint and ends with the same bytes as without
interruption. One torch thread is used: small matrices gain nothing from two, and are much slower on
a shared machine.
"""

import math
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from twin.errors import ModelError

from ..compute import CPU, device_named, one_thread
from ..data.flights import ResidualFlight
from ..model.compensator import Compensator
from ..model.family import (
    Family,
    FamilyPreset,
    ModelInfo,
    Progress,
    Tensors,
    TrainedModel,
    TrainingTask,
    check_flights,
    describe_training,
    silent,
)
from ..model.folder import CURVE, MODEL, load, save, write_json
from ..model.network import ClusterNetwork, SvqNetwork
from ..model.registry import check_preset
from ..preset import LINEAR, PRESETS, PROTOCOLS, Preset, Protocol
from .checkpoint import CHECKPOINT, TrainingState, load_checkpoint, save_checkpoint
from .losses import PARTS, losses
from .problem import TrainingProblem

Array = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
NETWORK = "network"
"""Name of the network's optimiser in the checkpoint."""
CHECKPOINT_S = 15.0
"""Time between two checkpoints, s."""
SLOWEST_RATE = 0.01
"""Final learning rate of the schedule, as a share of the initial one."""


def _fit(piece: TrainingProblem, training: str, folder: Path, progress: Progress) -> TrainingState:
    """Run the remaining epochs; the network ends with its best weights."""
    preset, network = piece.preset, piece.network
    optimiser = torch.optim.Adam(list(network.parameters()), lr=preset.learning_rate, fused=True)
    standing, best = TrainingState(training), _copy(network)
    found = load_checkpoint(folder, training, {NETWORK: optimiser})
    if found is not None:
        standing, weights, best = found
        network.load_state_dict(weights)
    began, done_before = time.monotonic(), standing.epoch
    saved = began
    while standing.epoch < preset.epochs and not _tired(standing, preset):
        entry = _epoch(piece, optimiser, standing.epoch)
        standing.epoch += 1
        if standing.epoch % preset.validate_every == 0 or standing.epoch == preset.epochs:
            error = piece.validation_error()
            entry["validation"] = error if math.isfinite(error) else None
            better = standing.best_error is None or error < standing.best_error
            if better or not math.isfinite(error):
                standing.best_error, standing.best_epoch = entry["validation"], standing.epoch
                best = _copy(network)
        standing.curve.append(entry)
        now = time.monotonic()
        if now - saved >= CHECKPOINT_S:
            save_checkpoint(folder, standing, network.state_dict(), best, {NETWORK: optimiser})
            saved = time.monotonic()
        per_epoch = (now - began) / (standing.epoch - done_before)
        progress(standing.epoch / preset.epochs, per_epoch * (preset.epochs - standing.epoch))
    network.load_state_dict(best)
    return standing


def _epoch(piece: TrainingProblem, optimiser: torch.optim.Optimizer, epoch: int) -> dict[str, Any]:
    """One pass over the training windows; returns mean losses."""
    preset, network = piece.preset, piece.network
    rate = preset.learning_rate * _schedule(preset, epoch)
    for group in optimiser.param_groups:
        group["lr"] = rate
    quantisers = [n.quantiser for n in network.networks if isinstance(n, ClusterNetwork)]
    device = network.phase_embedding.device
    state = torch.zeros(0, device=device)
    every: list[dict[str, float]] = []
    windows = piece.samples.windows(
        preset.batch,
        preset.window,
        piece.seed,
        epoch,
        preset.stride,
        preset.carry,
        preset.augment,
    )
    for window in windows:
        if window.begins:
            state = torch.zeros(len(window.known), network.state_size, device=device)
        here = window.at(device)
        out, state = network(here.known, here.features, here.phase, state.detach())
        if not bool(window.scored.any()):
            continue
        parts = losses(out, here.target, here.scored, network.clusters, quantisers, preset)
        optimiser.zero_grad(set_to_none=True)
        torch.autograd.backward(sum(parts.values()))  # type: ignore[arg-type]
        if preset.clip is not None:
            torch.nn.utils.clip_grad_norm_(network.parameters(), preset.clip)
        optimiser.step()
        if preset.clip_parameters is not None:
            _clamp(network, preset.clip_parameters)
        every.append({name: float(part.detach()) for name, part in parts.items()})
    means = {name: sum(e[name] for e in every) / max(len(every), 1) for name in PARTS}
    if not np.all(np.isfinite(list(means.values()))):
        raise ModelError(
            f"training: the loss is not finite in epoch {epoch + 1}; lower the preset's "
            f"learning_rate ({preset.learning_rate:g})"
        )
    return {"epoch": epoch + 1, "learning_rate": rate, **means, "validation": None}


@torch.no_grad()
def _clamp(network: SvqNetwork, size: float) -> None:
    """Limit the magnitude of every weight."""
    for parameter in network.parameters():
        parameter.clamp_(-size, size)


def _schedule(preset: Preset, epoch: int) -> float:
    if preset.schedule == "constant":
        return 1.0
    share = (1 + math.cos(math.pi * epoch / preset.epochs)) / 2
    return SLOWEST_RATE + (1 - SLOWEST_RATE) * share


def _tired(standing: TrainingState, preset: Preset) -> bool:
    if preset.patience is None or standing.best_error is None:
        return False
    return standing.epoch - standing.best_epoch >= preset.patience


def _copy(network: SvqNetwork) -> dict[str, Tensor]:
    return {k: v.detach().clone() for k, v in network.state_dict().items()}


def fit_model(
    flights: Sequence[ResidualFlight],
    family: Family[Any, Any],
    preset: FamilyPreset,
    task: TrainingTask,
    folder: Path,
    progress: Progress = silent,
) -> TrainedModel:
    """Train a model of any family on all flights and write its folder.

    Args:
        flights: Flights with one rate and number of commands.
        family: The family.
        preset: Preset of the family, possibly changed.
        task: Protocol, horizon, seed, vehicle.
        folder: Folder, created if it does not exist.
        progress: Called with the share done during the work, and at its end.

    Raises:
        ModelError: The flights do not match each other, the preset is not for this protocol, or the
            folder belongs to another training.
    """
    check_flights(flights)
    check_preset(family, preset, task.protocol)
    folder.mkdir(parents=True, exist_ok=True)
    with one_thread():
        model: TrainedModel = family.fit(flights, preset, task, folder, progress)
    save(model, folder)
    if task.checkpoints is None:
        (folder / CHECKPOINT).unlink(missing_ok=True)
    progress(1.0, 0.0)
    return model


class Svq(Family[Preset, Compensator]):
    """The paper's network with measured improvements."""

    name, usual, onnx = "svq", "best", True
    meaning = "FC-MC-SVQ network over the linear prediction"
    presets = PRESETS

    def protocols(self, preset: Preset) -> Sequence[Protocol]:
        """All protocols."""
        return PROTOCOLS

    def fit(
        self,
        flights: Sequence[ResidualFlight],
        preset: Preset,
        task: TrainingTask,
        folder: Path,
        progress: Progress,
    ) -> Compensator:
        """Train; resumes from a checkpoint in the folder, and loads a finished model of this
        training."""
        info = describe_training("svq", flights, preset, task)
        if (folder / MODEL).is_file():
            done = load(folder)
            if isinstance(done, Compensator) and done.info.training == info.training:
                return done
        place, device = task.checkpoints or folder, device_named(task.device)
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(task.seed)
            piece = TrainingProblem(flights, preset, task.protocol, task.horizon, task.seed)
            standing = TrainingState(info.training)
            if preset.network:
                piece.network.to(device)
                standing = _fit(piece, info.training, place, progress)
                piece.network.to(CPU)
            piece.calibrate()
        model, metrics = piece.compensator, {}
        if preset.network:
            metrics = {
                "epochs": standing.epoch,
                "best_epoch": standing.best_epoch,
                "validation_mse": piece.validation_mse(),
            }
            write_json(folder / CURVE, standing.curve)
        own = model.info
        model.info = replace(info, preset=own.preset, clusters=own.clusters, metrics=metrics)
        return model.eval()

    def build(self, info: ModelInfo[Preset], tensors: Tensors) -> Compensator:
        """Network with these weights."""
        model = Compensator(info)
        model.load_state_dict({k: torch.from_numpy(v) for k, v in tensors.items()})
        return model.eval()

    def export(self, model: Compensator, folder: Path) -> tuple[str, ...]:
        """Write the streaming model as ONNX, its int8 version, and reference vectors."""
        from ..export.write import INT8_FILE, MODEL_FILE, REFERENCE_FILE, export_onnx

        export_onnx(model, folder)
        return MODEL_FILE, INT8_FILE, REFERENCE_FILE


class Linear(Svq):
    """Autoregression directly to the horizon, or ridge regression on the twin's readings."""

    name = usual = LINEAR.name
    meaning = "the linear prediction alone: what the network has to beat"
    presets = MappingProxyType({LINEAR.name: LINEAR})

    def protocols(self, preset: Preset) -> Sequence[Protocol]:
        """All protocols except `reconstruct`, where the residual is known and needs no
        prediction."""
        return ("track", "free")
