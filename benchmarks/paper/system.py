"""What a system of the paper's comparison is: interface, training, model.

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
from typing import ClassVar, Literal

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
from learning.model.family import Corrected, Progress, no_alarm, silent
from learning.preset import Normalise, Protocol
from learning.training.checkpoint import TrainingState, load_checkpoint, save_checkpoint
from learning.training.windows import TrainingSamples, Window
from twin.errors import ModelError
from twin.representation import ShortRepr

Numbers = Mapping[str, NDArray[np.float32]]
Role = Literal["reconstruct", "track", "free", "generate"]
"""What a system is trained for: the protocols of a compensator, or to draw."""


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
        training: Names the training.
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
    for window in samples.windows(preset.batch, preset.window, seed, epoch):
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


@dataclass(frozen=True, slots=True)
class SystemModel(ShortRepr):
    """Weights, scaling, and what its draws come from.

    Attributes:
        system: Trained.
        role: For what.
        horizon: Samples, in `track`.
        scaling: Of residuals and features.
        prior: Of `System.learn_prior`; empty without one.
        expected: Rms of what it left of its training flights; of its draws the spread that they
            are to have, shape (phases, 15), units of the channels.
        seed: Of what it draws.
        draws: Whether it draws; else it says what it makes of the flight.
    """

    system: System
    role: Role
    horizon: int
    scaling: Scaling
    prior: Numbers
    expected: Array
    seed: int
    draws: bool

    def with_seed(self, seed: int) -> "SystemModel":
        """The same as a generator: it sees phases and span limits, and nothing that was measured.

        Args:
            seed: Of all draws; each flight has its own by its name.

        Raises:
            ModelError: It has not learned to generate.
        """
        if not (self.system.autoencoder or self.role == "generate"):
            raise ModelError(
                f"{self.system.preset.name} was trained to {self.role}: it draws nothing without a "
                "measurement. Train it with the role generate."
            )
        return replace(self, seed=seed, draws=True)

    @one_thread()
    @torch.no_grad()
    def run(self, flight: ResidualFlight) -> Corrected:
        """The whole flight; each span starts from zero. There is no envelope and no alarm."""
        n = len(flight.t_s)
        correction = np.zeros(flight.virtual.shape)
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(zlib.crc32(f"{self.seed} {flight.name}".encode()))
            for span in _spans([flight], self.scaling, self.role, self.horizon):
                said = self._said(span).double().numpy()
                mean, scale = self.scaling.mean[span.phase], self.scaling.scale[span.phase]
                correction[span.rows] = mean + scale * said
        spread = self.expected[flight.phase]
        return Corrected(correction, spread, no_alarm(n), np.ones(n, dtype=np.bool_))

    def _said(self, span: SpanSequence) -> Tensor:
        """Standardised residuals of a span, shape (n, 15)."""
        given = given_of(span, type(self.system), self.role)
        phase = _tensor(one_hot(span.phase))
        rows = torch.from_numpy(self._windows(len(phase)))  # (windows, length)
        if self.draws:
            said = self.system.generate(phase[rows], self.prior)
        else:
            said = self.system.reconstruct(given[rows], phase[rows])
        found = torch.zeros(len(phase), said.shape[-1])
        found[rows.flatten()] = said.flatten(0, 1)
        return found

    def _windows(self, n: int) -> NDArray[np.intp]:
        """Rows that go through the network together, shape (windows, length).

        Whatever sees no later sample gets the whole span; else windows of the training's length, of
        which the last reaches back.
        """
        length = min(self.system.preset.window, n) if self.system.sees_ahead else n
        starts = [*range(0, n - length, length), n - length]
        return np.asarray(np.array(starts)[:, None] + np.arange(length))


def roles(system: type[System]) -> tuple[Role, ...]:
    """What it can be trained for: all, but for `track` if its windows show it what comes."""
    every: tuple[Role, ...] = ("reconstruct", "track", "free", "generate")
    return tuple(r for r in every if r != "track" or not system.sees_ahead)


def given_of(span: SpanSequence, system: type[System], role: Role) -> Tensor:
    """What a system may see of a span, float32, shape (n, given).

    In `generate` nothing; but what an autoencoder learns from is the residual itself.
    """
    if role == "free":
        return _tensor(span.features)
    if role == "generate":
        return _tensor(span.d if system.autoencoder else span.d[:, :0])
    return _tensor(span.lags[..., 0])


def _spans(
    flights: Sequence[ResidualFlight], scaling: Scaling, role: Role, horizon: int
) -> list[SpanSequence]:
    """What draws is shown sequences as of `reconstruct`, and looks at none of their residuals."""
    protocol: Protocol = "reconstruct" if role == "generate" else role
    return sequences(flights, scaling, protocol, horizon)


def _tensor(values: Array) -> Tensor:
    return torch.from_numpy(values.astype(np.float32))


def begun(kind: type[System], preset: SystemPreset, role: Role, n_commands: int) -> System:
    """A system with weights as they begin, by torch's own generator."""
    n_given = len(CHANNELS)
    if role == "free":
        n_given = len(FEATURE_CHANNELS) + n_commands
    elif role == "generate" and not kind.autoencoder:
        n_given = 0
    return kind(preset, n_given, len(CHANNELS))


def fit_system(
    kind: type[System],
    flights: Sequence[ResidualFlight],
    preset: SystemPreset,
    role: Role,
    folder: Path,
    horizon: int = 0,
    seed: int = 0,
    device: str = "cpu",
    progress: Progress = silent,
) -> SystemModel:
    """Train on everything: nothing is held back, and the last epoch counts.

    Args:
        kind: The system.
        flights: For training.
        preset: Of the system.
        role: What it is trained for.
        folder: For the checkpoint, which stays there; its name tells this training from others.
        horizon: Samples, in `track`.
        seed: Of everything that is drawn.
        device: As of `learning.compute`.
        progress: Called after each epoch.
    """
    scaling = fit_scaling(flights, [in_spans(f) for f in flights], preset.normalise)
    spans = _spans(flights, scaling, role, horizon)
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        system = begun(kind, preset, role, flights[0].commands.shape[1])
        samples = TrainingSamples(spans, [s.d for s in spans], [s.fresh for s in spans])
        given, where = partial(_given, kind, role), device_named(device)
        with one_thread():
            train_players(
                system, samples, given, preset, seed, folder.name, folder, progress, where
            )
        prior = _prior(system, spans, role)
    nothing = np.zeros((N_PHASES, len(CHANNELS)))
    draws = role == "generate"
    model = SystemModel(system, role, horizon, scaling, prior, nothing, seed, draws)
    if draws:
        left = [f.residual - scaling.mean[f.phase] for f in flights]
    else:
        left = [f.residual - model.run(f).correction for f in flights]
    return replace(model, expected=np.sqrt(by_phase(flights, [e**2 for e in left])))


def _prior(system: System, spans: Sequence[SpanSequence], role: Role) -> Numbers:
    """What it draws from, of all spans one behind the other."""
    if not system.autoencoder:
        return {}
    known = [given_of(s, type(system), role) for s in spans]
    begins = np.zeros(sum(len(k) for k in known), dtype=np.bool_)
    begins[np.cumsum([0, *(len(k) for k in known[:-1])])] = True
    phases = np.concatenate([one_hot(s.phase) for s in spans]).astype(np.float32)
    with torch.no_grad():
        return system.learn_prior(
            torch.cat(list(known))[None], torch.from_numpy(phases)[None], begins
        )


def _given(system: type[System], role: Role, window: Window) -> Tensor:
    """What a system may see of a window; `given_of` says it of a span."""
    if role == "free":
        return window.features
    if role == "generate":
        return window.target if system.autoencoder else window.target[..., :0]
    return window.known
