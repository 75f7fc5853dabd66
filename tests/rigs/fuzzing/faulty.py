"""A kind whose reader falls as its file says: that faults are seen is a test, too."""

import os
import random
from pathlib import Path

from .engine import Seen, Step


class Faulty:
    """The kind."""

    file = "input"
    visible: frozenset[str] = frozenset({"set"})

    def bases(self) -> dict[str, bytes]:
        """One that is read."""
        return {"sound": b"sound"}

    def draw(self, rng: random.Random, blob: bytes) -> Step:
        """Any of its faults."""
        return "set", {"to": rng.choice(("memory", "raise", "die", "other"))}

    def apply(self, blob: bytes, step: Step) -> bytes:
        """What the file says."""
        return str(step[1]["to"]).encode()

    def read(self, path: Path) -> Seen:
        """Do as the file says."""
        content = path.read_text()
        match content:
            case "memory":
                bytearray(1_500_000_000)
            case "raise":
                raise IndexError("as the file said")
            case "die":
                os.abort()
        return Seen(content, frozenset())


KIND = Faulty()
