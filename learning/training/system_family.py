"""What makes a family of a system: training, building, nothing to export sample by sample."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import ClassVar

import numpy as np
import torch
from torch import Tensor

from ..data.channels import N_PHASES
from ..data.flights import ResidualFlight
from ..data.scaling import fit_scaling, in_spans
from ..data.sequences import SpanSequence, one_hot, sequences
from ..devices import device_named
from ..model.baselines import by_phase
from ..model.family import Family, Progress, Tensors, TrainingTask
from ..model.folder import CURVE, write_json
from ..model.generative import SystemModel, given_of
from ..model.info import ModelInfo
from ..preset import Protocol
from ..systems.system import Numbers, System, SystemPreset
from .checkpoint import CHECKPOINT
from .inputs import describe_training
from .players import train_players
from .windows import TrainingSamples, Window


class SystemFamily(Family[SystemPreset, SystemModel]):
    """A system with its preset; the family is called as the preset is."""

    system: ClassVar[type[System]]
    preset: ClassVar[SystemPreset]

    @property
    def sees_ahead(self) -> bool:
        """Whether what it says of a sample depends on later ones of its window."""
        return self.system.sees_ahead

    def presets(self) -> Mapping[str, SystemPreset]:
        """One."""
        return {self.preset.name: self.preset}

    def protocols(self, preset: SystemPreset) -> Sequence[Protocol]:
        """All, but for `track` of a system whose windows show it what comes."""
        every: tuple[Protocol, ...] = ("reconstruct", "track", "free", "generate")
        return tuple(p for p in every if p != "track" or not self.sees_ahead)

    def fit(
        self,
        flights: Sequence[ResidualFlight],
        preset: SystemPreset,
        task: TrainingTask,
        folder: Path,
        progress: Progress,
    ) -> SystemModel:
        """Train on everything: nothing is held back, and the last epoch counts."""
        info = describe_training(self.preset.name, flights, preset, task)
        scaling = fit_scaling(flights, [in_spans(f) for f in flights], preset.normalise)
        spans = sequences(flights, scaling, task.protocol, task.horizon)
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(task.seed)
            system = self._begun(info)
            samples = TrainingSamples(spans, [s.d for s in spans], [s.fresh for s in spans])
            given = partial(_given, self.system, task.protocol)
            seed, training = task.seed, info.training
            device = device_named(task.device)
            place = task.checkpoints or folder
            curve = train_players(
                system, samples, given, preset, seed, training, place, progress, device
            )
            prior = self._prior(system, spans, task.protocol)
        if task.checkpoints is None:
            (folder / CHECKPOINT).unlink(missing_ok=True)
        write_json(folder / CURVE, curve)
        nothing = np.zeros((N_PHASES, len(info.channels)))
        info = replace(info, metrics={"epochs": preset.epochs, "best_epoch": preset.epochs})
        model = SystemModel(info, self.preset.name, system, scaling, prior, nothing)
        if task.protocol == "generate":
            left = [f.residual - scaling.mean[f.phase] for f in flights]
        else:
            left = [f.residual - model.run(f).correction for f in flights]
        return replace(model, expected=np.sqrt(by_phase(flights, [e**2 for e in left])))

    def build(self, info: ModelInfo[SystemPreset], tensors: Tensors) -> SystemModel:
        """The system with these weights."""
        with torch.random.fork_rng(devices=[]):
            system = self._begun(info)
        return SystemModel.of_tensors(info, self.preset.name, system, tensors)

    def export(self, model: SystemModel, folder: Path) -> tuple[str, ...]:
        """None: no system is made to go sample by sample."""
        return ()

    def _begun(self, info: ModelInfo[SystemPreset]) -> System:
        n_channels = len(info.channels)
        n_given = n_channels
        if info.protocol == "free":
            n_given = len(info.channels.seen) + info.n_commands
        elif info.protocol == "generate" and not self.system.autoencoder:
            n_given = 0
        return self.system(info.preset, n_given, n_channels)

    def _prior(self, system: System, spans: Sequence[SpanSequence], protocol: Protocol) -> Numbers:
        """What it draws from, of all spans one behind the other."""
        if not self.system.autoencoder:
            return {}
        known = [given_of(s, self.system, protocol) for s in spans]
        begins = np.zeros(sum(len(k) for k in known), dtype=np.bool_)
        begins[np.cumsum([0, *(len(k) for k in known[:-1])])] = True
        phases = np.concatenate([one_hot(s.phase) for s in spans]).astype(np.float32)
        with torch.no_grad():
            return system.learn_prior(
                torch.cat(list(known))[None], torch.from_numpy(phases)[None], begins
            )


def _given(system: type[System], protocol: Protocol, window: Window) -> Tensor:
    """What a system may see of a window; `given_of` says it of a span."""
    if protocol == "free":
        return window.features
    if protocol == "generate":
        return window.target if system.autoencoder else window.target[..., :0]
    return window.known
