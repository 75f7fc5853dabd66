"""Journal of a training of a learned force, so that it resumes after an interruption.

The training is a deterministic sequence of steps that depend on the flights, the vehicle, the seed
and the earlier steps. Results of the slow steps are lines of a journal; a resumed training reads
them in the same order instead of simulating again, and gives byte-identical results.
"""

import base64
import hashlib
import json
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from twin.logs import Flight

from ..jobs import journal
from ..vehicles import Vehicle

Array = NDArray[np.float64]
CHECKPOINT = "checkpoint.jsonl"  # in the folder of a law


class Memory(journal.Journal[str]):
    """Journal of the step results of one training, in order."""

    kind = "training of a learned force"
    differs = "other flights, vehicle, seed or version"

    def __init__(self, path: Path, key: str) -> None:
        """See `Journal`."""
        super().__init__(path, key)
        self._stored = [content for _, content in self.contents()]
        self._step = 0

    def named(self, content: journal.Content) -> str:
        """Name of the step."""
        _array(content)
        return str(content["what"])

    def array(self, what: str, make: Callable[[], Array]) -> Array:
        """Result of the next step, from the journal if it is there.

        Args:
            what: Name of the step, which must equal that in the journal.
            make: Function that computes the step.
        """
        self._step += 1
        if self._step > len(self._stored):
            made = np.asarray(make(), dtype=np.float64)
            self._add(what, made)
            return made
        stored = self._stored[self._step - 1]
        if stored["what"] != what:
            raise self.foreign(self._step + 1)
        return _array(stored)

    def _add(self, what: str, array: Array) -> None:
        content = base64.b64encode(array.tobytes()).decode()
        self.write({"what": what, "shape": array.shape, "array": content})


def _array(content: journal.Content) -> Array:
    """Array from a line of the journal."""
    flat = np.frombuffer(base64.b64decode(content["array"], validate=True), dtype=np.float64)
    return flat.reshape(content["shape"]).copy()


def training_key(flights: Sequence[Flight], vehicle: Vehicle, seed: int) -> str:
    """Hash of all inputs that determine the law."""
    import uavtwin

    names = [[f.name, f.fingerprint] for f in flights]
    content = [uavtwin.__version__, names, vehicle.toml(), seed]
    return hashlib.sha256(json.dumps(content).encode()).hexdigest()
