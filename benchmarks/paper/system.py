"""What a system of the paper's comparison is: interface, training, model and family.

A system works on standardised windows, (batch, time, channels). What it may see of them is
`given`: the residual itself in `reconstruct`, an older one in `track`, virtual signals and commands
in `free`, nothing in `generate`. All that is drawn comes from torch's own generator.

Systems are trained with one optimiser per player, in turn; the same seed gives the same bytes. A
training that was cut off goes on from its last checkpoint and ends with the bytes that it would
have had uninterrupted: what an epoch draws depends on the seed and its number alone.
"""

import time
import zlib
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from learning.compute import CPU, device_named, one_thread
from learning.data.channels import CHANNELS, FEATURE_CHANNELS, N_PHASES
from learning.data.flights import ResidualFlight
from learning.data.scaling import Scaling, fit_scaling, in_spans
from learning.data.sequences import SpanSequence, one_hot, sequences
from learning.model.baselines import by_phase
from learning.model.family import (
    Corrected,
    Family,
    ModelInfo,
    Progress,
    Tensors,
    TrainingTask,
    describe_training,
    no_alarm,
)
from learning.model.folder import CURVE, write_json
from learning.preset import Normalise, Protocol
from learning.training.checkpoint import CHECKPOINT, TrainingState, load_checkpoint, save_checkpoint
from learning.training.windows import TrainingSamples, Window
from twin.errors import ModelError
from twin.representation import short_repr

Numbers = Mapping[str, NDArray[np.float32]]


@dataclass(frozen=True, slots=True)
class SystemPreset:
    """Hyper-parameters: the paper's Table I for all, what else makes a system is in its module.

    Attributes:
        name: As printed.
        units: Of each LSTM.
        code_size: Of the latent and the codes.
        n_codes: Of each codebook.
        normalise: As in `learning.preset.Preset`.
        learning_rate: Of Adam, for all that is trained.
        epochs: Of the training.
        batch: Windows per step.
        window: Samples.
        stride: Between the starts of two windows; None: `window`.
        carry: No state is carried on to the next.
        augment: Nothing is changed at random.
    """

    name: str
    units: int = 64
    code_size: int = 128
    n_codes: int = 512
    normalise: Normalise = "pooled"
    learning_rate: float = 1e-3
    epochs: int = 250
    batch: int = 4
    window: int = 100
    stride: int | None = None
    carry: int = 1
    augment: float = 0.0


@dataclass(frozen=True, slots=True)
class Batch:
    """Windows for one step, shapes (batch, time, ...).

    Attributes:
        given: What may be seen.
        phase: One-hot.
        target: Residuals.
        scored: 1 where a residual was measured and counts, else 0; of the shape of `target`.
        done: Share of the training that is behind, 0..1.
    """

    given: Tensor
    phase: Tensor
    target: Tensor
    scored: Tensor
    done: float


class System(nn.Module, ABC):
    """A network, or several that are trained in turn.

    Args:
        preset: Sizes.
        n_given: Numbers per sample that may be seen.
        n_channels: Of the residual.
    """

    autoencoder: ClassVar[bool] = False
    """Whether it generates by what it learned in `reconstruct`; else it learns to `generate`."""
    sees_ahead: ClassVar[bool] = False
    """Whether what it says of a sample depends on later ones of its window."""
    against: ClassVar[tuple[float, float]] = 0.5, 0.9
    """Memory of Adam where players work against each other (Radford, Metz & Chintala 2016)."""

    def __init__(self, preset: SystemPreset, n_given: int, n_channels: int) -> None:
        super().__init__()
        self.preset, self.n_given, self.n_channels = preset, n_given, n_channels
        self.n_phases = N_PHASES

    def turns(self, done: float) -> tuple[str, ...]:
        """Who is trained on a batch, one after the other."""
        return ("network",)

    def players(self) -> dict[str, nn.Module]:
        """What is trained by an optimiser of its own, by the names of `turns`."""
        return {"network": self}

    @abstractmethod
    def loss(self, player: str, batch: Batch) -> Tensor:
        """What a player is to make small."""

    def after_step(self, player: str) -> None:
        """Called when the player's weights have changed."""
        return

    @abstractmethod
    def reconstruct(self, given: Tensor, phase: Tensor) -> Tensor:
        """Residuals of what is given, shape (batch, time, channels)."""

    def learn_prior(self, given: Tensor, phase: Tensor, begins: NDArray[np.bool_]) -> Numbers:
        """What `generate` draws from, where that is not noise alone.

        Args:
            given: All of the training, one span behind the other, shape (1, n, given).
            phase: One-hot, shape (1, n, phases).
            begins: Where a span begins, shape (n,).
        """
        return {}

    @abstractmethod
    def generate(self, phase: Tensor, prior: Numbers) -> Tensor:
        """Residuals as they might have been, shape (batch, time, channels).

        Args:
            phase: One-hot, shape (batch, time, phases).
            prior: Of `learn_prior`.
        """


def mean_square(error: Tensor, scored: Tensor) -> Tensor:
    """Mean of the squares that count."""
    return (error**2 * scored).sum() / scored.sum().clamp(min=1)


def mean_absolute(error: Tensor, scored: Tensor) -> Tensor:
    """Mean of the absolute values that count."""
    return (error.abs() * scored).sum() / scored.sum().clamp(min=1)


# ----------------------------------------------------------------------------------------
# Training of systems: one optimiser per player, in turn; the same seed gives the same bytes.
#
# A training that was cut off goes on from its last checkpoint and ends with the bytes that it
# would have had uninterrupted: what an epoch draws depends on the seed and its number alone.

ALONE = 0.9, 0.999
"""Memory of Adam; players that work against each other forget sooner: `System.against`."""
CHECKPOINT_S = 15.0
"""Between two of them."""


def train_players(
    system: System,
    samples: TrainingSamples,
    given: Callable[[Window], Tensor],
    preset: SystemPreset,
    seed: int,
    training: str,
    folder: Path,
    progress: Progress,
    device: torch.device = CPU,
) -> list[dict[str, float]]:
    """Train a system to the end of its epochs.

    Args:
        system: Begun; ends trained, on the processor.
        samples: Residuals, as `target`, and what goes with them.
        given: What the system may see of a window.
        preset: Of the system.
        seed: Of all draws.
        training: Hash of all that decides the weights.
        folder: For the checkpoint, which stays there.
        progress: Called after each epoch.
        device: To train on.

    Returns:
        Mean loss of each player by epoch.

    Raises:
        ModelError: A loss is not finite, or the folder's checkpoint is of another training.
    """
    system.to(device)
    players = system.players()
    betas = ALONE if len(players) == 1 else system.against
    optimisers = {
        name: torch.optim.Adam(
            player.parameters(), lr=preset.learning_rate, betas=betas, fused=True
        )
        for name, player in players.items()
    }
    standing = TrainingState(training)
    found = load_checkpoint(folder, training, optimisers)
    if found is not None:
        standing, weights, _ = found
        system.load_state_dict(weights)
    began = saved = time.monotonic()
    before = standing.epoch
    system.train()
    while standing.epoch < preset.epochs:
        losses = _epoch(system, optimisers, samples, given, preset, seed, standing.epoch, device)
        standing.epoch += 1
        standing.curve.append({"epoch": standing.epoch, **losses})
        now = time.monotonic()
        if now - saved >= CHECKPOINT_S:
            save_checkpoint(folder, standing, system.state_dict(), {}, optimisers)
            saved = time.monotonic()
        left = (now - began) / (standing.epoch - before) * (preset.epochs - standing.epoch)
        progress(standing.epoch / preset.epochs, left)
    system.to(CPU).eval()
    return standing.curve


def _epoch(
    system: System,
    optimisers: Mapping[str, torch.optim.Optimizer],
    samples: TrainingSamples,
    given: Callable[[Window], Tensor],
    preset: SystemPreset,
    seed: int,
    epoch: int,
    device: torch.device,
) -> dict[str, float]:
    """One pass over the windows; mean loss by player."""
    torch.manual_seed(int(np.random.SeedSequence([seed, epoch]).generate_state(1)[0]))
    sums: dict[str, list[float]] = {}
    done, players = epoch / preset.epochs, system.players()
    for window in samples.windows(preset, seed, epoch):
        here = window.at(device)
        batch = Batch(given(here), here.phase, here.target, here.scored, done)
        for player in system.turns(done):
            loss = system.loss(player, batch)
            system.zero_grad(set_to_none=True)
            loss.backward(inputs=list(players[player].parameters()))  # type: ignore[no-untyped-call]
            optimisers[player].step()
            system.after_step(player)
            sums.setdefault(player, []).append(float(loss.detach()))
    means = {player: float(np.mean(values)) for player, values in sums.items()}
    if not np.all(np.isfinite(list(means.values()))):
        raise ModelError(
            f"training: the loss is not finite in epoch {epoch + 1} ({means}); lower the preset's "
            f"learning_rate ({preset.learning_rate:g})"
        )
    return means


# ----------------------------------------------------------------------------------------
# A system that was trained, as a model: windows or whole spans in, residuals out.

Array = NDArray[np.float64]
_SCALING, _PRIOR, _NETWORK, _EXPECTED = "scaling.", "prior.", "network.", "expected"


@dataclass(frozen=True, slots=True)
class SystemModel:
    """Weights, scaling, and what its draws come from.

    Attributes:
        info: What it is.
        name: Its row in the registry.
        system: Trained.
        scaling: Of residuals and features.
        prior: Of `System.learn_prior`; empty without one.
        expected: Rms of what it left of its training flights; of its draws the spread that they
            are to have, shape (phases, 15), units of the channels.
        draws: Seed of what it draws; None: it says what it makes of the flight.
    """

    info: ModelInfo[SystemPreset]
    name: str
    system: System
    scaling: Scaling
    prior: Numbers
    expected: Array
    draws: int | None = None

    __repr__ = short_repr

    @property
    def family(self) -> str:
        """Its row in the registry."""
        return self.name

    def with_seed(self, seed: int) -> "SystemModel":
        """The same as a generator: it sees phases and span limits, and nothing that was measured.

        Args:
            seed: Of all draws; each flight has its own by its name.

        Raises:
            ModelError: It has not learned to generate.
        """
        if not (self.system.autoencoder or self.info.protocol == "generate"):
            raise ModelError(
                f"{self.name} was trained to {self.info.protocol}: it draws nothing without a "
                "measurement. Train it with the protocol generate."
            )
        return replace(self, draws=seed)

    @one_thread()
    @torch.no_grad()
    def run(self, flight: ResidualFlight) -> Corrected:
        """The whole flight; each span starts from zero. There is no envelope and no alarm."""
        self.info.check_flight(flight)
        n = len(flight.t_s)
        correction = np.zeros(flight.virtual.shape)
        draws = self.info.seed if self.draws is None else self.draws
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(zlib.crc32(f"{draws} {flight.name}".encode()))
            protocol, horizon = self.info.protocol, self.info.horizon
            for span in sequences([flight], self.scaling, protocol, horizon):
                said = self._said(span).double().numpy()
                mean, scale = self.scaling.mean[span.phase], self.scaling.scale[span.phase]
                correction[span.rows] = mean + scale * said
        spread = self.expected[flight.phase]
        return Corrected(correction, spread, no_alarm(n), np.ones(n, dtype=np.bool_))

    def _said(self, span: SpanSequence) -> Tensor:
        """Standardised residuals of a span, shape (n, 15)."""
        given = given_of(span, type(self.system), self.info.protocol)
        phase = _tensor(one_hot(span.phase))
        rows = torch.from_numpy(self._windows(len(phase)))  # (windows, length)
        if self.draws is None and self.info.protocol != "generate":
            said = self.system.reconstruct(given[rows], phase[rows])
        else:
            said = self.system.generate(phase[rows], self.prior)
        found = torch.zeros(len(phase), said.shape[-1])
        found[rows.flatten()] = said.flatten(0, 1)
        return found

    def _windows(self, n: int) -> NDArray[np.intp]:
        """Rows that go through the network together, shape (windows, length).

        Whatever sees no later sample gets the whole span; else windows of the training's length, of
        which the last reaches back.
        """
        length = min(self.info.preset.window, n) if self.system.sees_ahead else n
        starts = [*range(0, n - length, length), n - length]
        return np.asarray(np.array(starts)[:, None] + np.arange(length))

    def tensors(self) -> dict[str, NDArray[Any]]:
        """Weights, scaling, prior."""
        network = {k: v.detach().cpu().numpy() for k, v in self.system.state_dict().items()}
        return {
            **{_NETWORK + k: v for k, v in network.items()},
            **{_SCALING + k: v for k, v in self.scaling.arrays().items()},
            **{_PRIOR + k: v for k, v in self.prior.items()},
            _EXPECTED: self.expected,
        }

    def details(self) -> Mapping[str, Any]:
        """Nothing more."""
        return {}

    @classmethod
    def of_tensors(
        cls, info: ModelInfo[SystemPreset], name: str, system: System, tensors: Mapping[str, Any]
    ) -> "SystemModel":
        """The model that has these numbers; the system's weights are overwritten.

        Raises:
            KeyError, RuntimeError, ValueError: They do not fit.
        """
        scaling = Scaling(**_under(tensors, _SCALING))
        weights = {k: torch.from_numpy(v) for k, v in _under(tensors, _NETWORK).items()}
        system.load_state_dict(weights)
        expected = tensors[_EXPECTED]
        if expected.shape != (N_PHASES, len(CHANNELS)):
            raise ValueError(f"expected spread of shape {expected.shape}")
        return cls(info, name, system.eval(), scaling, _under(tensors, _PRIOR), expected)


def given_of(span: SpanSequence, system: type[System], protocol: Protocol) -> Tensor:
    """What a system may see of a span, float32, shape (n, given).

    In `generate` nothing; but what an autoencoder learns from is the residual itself.
    """
    if protocol == "free":
        return _tensor(span.features)
    if protocol == "generate":
        return _tensor(span.d if system.autoencoder else span.d[:, :0])
    return _tensor(span.lags[..., 0])


def _tensor(values: Array) -> Tensor:
    return torch.from_numpy(values.astype(np.float32))


def _under(tensors: Mapping[str, Any], prefix: str) -> dict[str, Any]:
    return {k.removeprefix(prefix): v for k, v in tensors.items() if k.startswith(prefix)}


# ----------------------------------------------------------------------------------------
# What makes a family of a system: training, building, nothing to export sample by sample.


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
        nothing = np.zeros((N_PHASES, len(CHANNELS)))
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
        n_channels = len(CHANNELS)
        n_given = n_channels
        if info.protocol == "free":
            n_given = len(FEATURE_CHANNELS) + info.n_commands
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
