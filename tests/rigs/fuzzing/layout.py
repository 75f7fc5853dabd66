"""Where numbers stand in a binary log, to read and to change them there."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True)
class Layout:
    """Where the samples of one topic, or the messages of one name, stand in a log.

    Attributes:
        at: Where each begins, shape (n,).
        fields: Distance of each field from there, and its type.
    """

    at: NDArray[np.int64]
    fields: dict[str, tuple[int, np.dtype[Any]]]

    def get(self, blob: bytes, field: str) -> NDArray[Any]:
        """Values of a field, shape (n,)."""
        offset, kind = self.fields[field]
        raw = np.frombuffer(blob, np.uint8)
        place = self.at[:, None] + offset + np.arange(kind.itemsize)
        return np.ascontiguousarray(raw[place]).view(kind)[:, 0]

    def put(self, blob: bytes, field: str, values: NDArray[Any]) -> bytes:
        """The log with other values of a field."""
        offset, kind = self.fields[field]
        raw = np.frombuffer(blob, np.uint8).copy()
        place = self.at[:, None] + offset + np.arange(kind.itemsize)
        with np.errstate(invalid="ignore", over="ignore"):
            new = np.ascontiguousarray(values.astype(kind)).view(np.uint8)
        raw[place] = new.reshape(len(self.at), -1)
        return raw.tobytes()
