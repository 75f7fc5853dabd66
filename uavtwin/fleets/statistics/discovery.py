"""Many tests at once: which of them count, so that few of those that do are false.

Source: Benjamini, Hochberg, J. R. Stat. Soc. B 57 (1995) 289-300, by
`scipy.stats.false_discovery_control`. It holds for independent tests and for those that go up and
down together; numbers of one flight are of that kind.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.stats import false_discovery_control

Array = NDArray[np.float64]
FALSE_SHARE = 0.05
"""Of what is told to differ or to drift, the share that is expected to be false."""


def adjusted(p: Sequence[float]) -> Array:
    """Smallest share of false discoveries at which each test counts, shape (n,).

    Args:
        p: Probability of each under its hypothesis that there is nothing.
    """
    return np.asarray(false_discovery_control(p)) if len(p) else np.zeros(0)
