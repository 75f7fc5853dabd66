"""What a training of a learned force has found so far, so that it is resumed after a kill.

The training is a fixed sequence of steps, each decided by the flights, the vehicle, the seed and
the steps before. The results of those that take long are lines of a journal; a training that is
resumed reads them in the same order instead of flying again, and ends with the same bytes.
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
    """Results of the steps of one training, in order."""

    kind = "training of a learned force"
    differs = "other flights, vehicle, seed or version"

    def __init__(self, path: Path, key: str) -> None:
        """See `Journal`."""
        super().__init__(path, key)
        self._stored = [content for _, content in self.contents()]
        self._step = 0

    def named(self, content: journal.Content) -> str:
        """The step."""
        _array(content)
        return str(content["what"])

    def array(self, what: str, make: Callable[[], Array]) -> Array:
        """Result of the next step, from the journal where it is there.

        Args:
            what: The step, which is held against the journal's.
            make: Takes the step.
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
    """That of a line."""
    flat = np.frombuffer(base64.b64decode(content["array"], validate=True), dtype=np.float64)
    return flat.reshape(content["shape"]).copy()


def training_key(flights: Sequence[Flight], vehicle: Vehicle, seed: int) -> str:
    """Hash of all that decides what is learned."""
    import uavtwin

    names = [[f.name, f.fingerprint] for f in flights]
    content = [uavtwin.__version__, names, vehicle.toml(), seed]
    return hashlib.sha256(json.dumps(content).encode()).hexdigest()
