"""The network of a learned force: trained on what the law leaves, chosen by flying it.

FC-MC-SVQ as of the sensors' compensator, its six outputs added to the law inside the envelope.
Output by output it is used where it beats the law on flights that took no part, and not there else.
"""

import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cosim.whole_twin import fused_model
from fmus import build
from fmus.compensator import NetworkFile, native_model, read_network
from learning.export.write import export_onnx
from learning.force.candidates import Candidate
from learning.force.model import Flown, network_starts, observer_starts
from learning.force.sequence import residual_sequence
from learning.force.train import Prepared
from learning.preset import FORCE
from learning.training.train import train
from twin.flight.assembly import driven_twin
from twin.physics.residual_force import OUTPUTS
from twin.physics.rotors import Drive

from .choice import as_flown, best_law, weight_starts
from .open_loop import Replay

Array = NDArray[np.float64]
NETWORK = "svq"
"""Its name among the laws."""
Progress = Callable[[float], None]


def train_network(
    prepared: Prepared, flights: Sequence[int], chosen: Sequence[Candidate], seed: int, folder: Path
) -> NetworkFile:
    """The network of some flights, exported.

    Args:
        prepared: All flights.
        flights: Which of them.
        chosen: Law of each output, fitted to these.
        seed: Of everything that is drawn.
        folder: To write it into.
    """
    weights = np.stack([c.weights for c in chosen])
    residuals = [residual_sequence(prepared.seen[i], prepared.designs[i], weights) for i in flights]
    export_onnx(train(residuals, FORCE, "free", 0, seed, folder), folder)
    return read_network(folder)


def flown_network(
    prepared: Prepared,
    fitted: Sequence[Sequence[Candidate]],
    replays: Sequence[Replay],
    drive: Drive,
    seed: int,
    progress: Progress,
) -> tuple[Flown, ...]:
    """What the network does, output by output, on flights left out.

    Args:
        prepared: All flights.
        fitted: By flight left out, the law of each output, fitted to the others.
        replays: Of the flights.
        drive: Of the twin.
        seed: Of everything that is drawn.
        progress: Called with the share done.
    """
    rows, steps, done = range(len(replays)), len(OUTPUTS) + 2, 1
    with tempfile.TemporaryDirectory() as name:
        fmus, starts = [], []
        for out in rows:
            folder = Path(name, str(out))
            others = [i for i in rows if i != out]
            network = train_network(prepared, others, fitted[out], seed, folder)
            law = prepared.law(fitted[out])[0]
            parts = driven_twin(prepared.vehicle, drive, (), law, network=True)
            model = fused_model(parts, prepared.vehicle.name, native_model(network))
            fmus.append(build(model, folder / "twin.fmu"))
            starts.append(weight_starts(law) | observer_starts([c.observer for c in fitted[out]]))
        progress(done / steps)

        def errors(used: Sequence[bool]) -> Array:
            """Mean squares over the flights left out, shape (horizons, 4, 3)."""
            nonlocal done
            shares = network_starts(used)
            squares = [
                np.mean(replay.through(fmu, own | shares).off ** 2, axis=0)
                for replay, fmu, own in zip(replays, fmus, starts, strict=True)
            ]
            done += 1
            progress(done / steps)
            return np.asarray(np.mean(squares, axis=0))

        used = [False] * len(OUTPUTS)
        found: list[Flown] = []
        least = errors(used)
        for i in range(len(OUTPUTS)):
            tried = errors([*used[:i], True, *used[i + 1 :]])
            found.append(as_flown(NETWORK, tried / least))
            if best_law(found[-1:]) == NETWORK:
                used[i], least = True, tried
    return tuple(found)
