"""The network of a learned force: trained on what the law leaves, chosen by flying it.

FC-MC-SVQ as of the sensors' compensator, its six outputs added to the law inside the envelope.
Output by output it is used where it beats the law on flights that took no part, and not there else.
"""

import tempfile
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import cast

import numpy as np
from numpy.typing import NDArray

from cosim.whole_twin import fused_model
from fmus import build
from fmus.compensator import native_model, read_network
from learning.export.write import export_onnx
from learning.force.candidates import WORTH
from learning.force.model import Flown, network_starts
from learning.force.regression import moments_of, pieces_of, saved, summed
from learning.force.sequence import residual_sequence
from learning.force.train import Prepared
from learning.model.compensator import Compensator
from learning.model.folder import load
from learning.preset import FORCE
from learning.training.train import train
from twin.flight.assembly import driven_twin
from twin.physics.residual_force import OUTPUTS, ForceLaw
from twin.physics.rotors import Drive

from .choice import Steps, as_flown, best_law
from .fold import Fold
from .memory import Memory

Array = NDArray[np.float64]
NETWORK = "svq"
"""Its name among the laws."""


def train_network(
    prepared: Prepared, law: ForceLaw, seed: int, folder: Path, memory: Memory
) -> Compensator:
    """The network of what a law leaves, exported.

    Args:
        prepared: Flights to learn from.
        law: That is used, with its waves.
        seed: Of everything that is drawn.
        folder: To write it into.
        memory: Of the steps that were taken before.
    """

    def make() -> None:
        """Train and export."""
        weights = prepared.weights(law)
        residuals = [
            residual_sequence(seen, design, weights)
            for seen, design in zip(prepared.seen, prepared.designs, strict=True)
        ]
        export_onnx(train(residuals, FORCE, "free", 0, seed, folder), folder)

    memory.files(f"network {folder.name}", folder, make)
    return cast(Compensator, load(folder))


def flown_network(
    folds: Sequence[Fold],
    laws: Sequence[str],
    drive: Drive,
    seed: int,
    progress: Callable[[float], None],
) -> list[Flown]:
    """What the network does, output by output, on flights left out.

    Args:
        folds: One per flight.
        laws: Law of each output.
        drive: Of the twin.
        seed: Of everything that is drawn.
        progress: Called with the share done.
    """
    steps = Steps(2 * len(folds) + len(OUTPUTS) + 1, progress)
    with tempfile.TemporaryDirectory() as name:
        gains, folders = np.zeros(len(OUTPUTS)), []
        for k, fold in enumerate(folds):
            folders.append(Path(name, str(k)))
            law = fold.lesson.law(laws)
            network = train_network(fold.lesson.prepared, law, seed, folders[-1], fold.memory)
            gains += _gains(fold, law, network)
            steps.one()
        if not (gains > WORTH).any():
            return [Flown(NETWORK, gain) for gain in gains.tolist()]
        twins = []
        for fold, folder in zip(folds, folders, strict=True):
            vehicle = fold.lesson.prepared.vehicle
            parts = driven_twin(vehicle, drive, (), fold.lesson.law(laws), network=True)
            model = fused_model(parts, vehicle.name, native_model(read_network(folder)))
            twins.append((fold, build(model, folder / "twin.fmu"), fold.lesson.starts(laws)))
            steps.one()

        def squares(used: Sequence[bool]) -> Array:
            """Mean squares of each flight left out, shape (flights, horizons, 4, 3)."""
            shares = network_starts(used)
            off = [
                fold.memory.array(
                    f"network {fmu.parent.name} {used}", partial(fold.squares, fmu, starts | shares)
                )
                for fold, fmu, starts in twins
            ]
            steps.one()
            return np.stack(off)

        used = [False] * len(OUTPUTS)
        found: list[Flown] = []
        least = squares(used)
        for i, gain in enumerate(gains.tolist()):
            if gain <= WORTH:
                found.append(Flown(NETWORK, gain))
                continue
            tried = squares([*used[:i], True, *used[i + 1 :]])
            found.append(as_flown(NETWORK, gain, tried, least))
            if best_law(found[-1:]) == NETWORK:
                used[i], least = True, tried
    return found


def _gains(fold: Fold, law: ForceLaw, network: Compensator) -> Array:
    """Nats by which the flight left out is more probable with the network, shape (6,)."""
    prepared = fold.lesson.prepared
    weights = prepared.weights(law)
    taught = [design.leaves(weights) for design in prepared.designs]
    pieces = [pieces_of(design.piece) for design in prepared.designs]
    design = prepared.design(fold.seen)
    before = design.leaves(weights)
    after = before - network.run(residual_sequence(fold.seen, design, weights)).correction
    gains = []
    for i in range(len(OUTPUTS)):
        noise = summed(
            [moments_of(left[:, [i]], rows) for left, rows in zip(taught, pieces, strict=True)]
        )
        both = np.column_stack([before[:, i], after[:, i]])
        gains.append(saved(noise, moments_of(both, pieces_of(design.piece))))
    return np.array(gains)
