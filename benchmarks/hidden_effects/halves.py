"""Two halves of plants and effects: thresholds and priors are chosen on one, the other scores them.

The digest of plant and hidden effects decides, so that an effect that was tuned on in one plant is
never scored in it, whatever its size, noise and seed. Where nothing is hidden, or one of a few
things has happened to a calibrated aircraft, the seed decides as well.
"""

import hashlib
from collections.abc import Iterable

TUNE, SCORE = HALVES = ("tune", "score")


def half_of(plant: str, kind: str, effects: Iterable[str], seed: int) -> str:
    """The half that a case belongs to."""
    names = "+".join(sorted(effects))
    text = f"{plant}/{names}"
    if not names or kind == "since":
        text += f"/{kind}/{seed}"
    return HALVES[hashlib.sha256(text.encode()).digest()[0] % 2]
