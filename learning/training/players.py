"""Training of systems: one optimiser per player, in turn; the same seed gives the same bytes.

A training that was cut off goes on from its last checkpoint and ends with the bytes that it would
have had uninterrupted: what an epoch draws depends on the seed and its number alone.
"""

import time
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from twin.errors import ModelError

from ..devices import CPU
from ..model.family import Progress
from ..systems.system import Batch, System, SystemPreset
from .checkpoint import Standing, load_checkpoint, save_checkpoint
from .windows import TrainingSamples, Window

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
    standing = Standing(training)
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
