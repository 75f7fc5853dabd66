"""What a law leaves of force and moment, as sequences that a network learns from.

The network is that of the sensors' compensator, FC-MC-SVQ: six channels in place of fifteen, the
motion in place of what the twin's sensors read.
"""

import numpy as np
from numpy.typing import NDArray

from twin.residuals.channels import CHANNEL_HZ

from ..data.channels import FORCES, UNKNOWN_PHASE
from ..data.flights import ResidualFlight
from .candidates import Design
from .instants import Instants

Array = NDArray[np.float64]


def residual_sequence(instants: Instants, design: Design, weights: Array) -> ResidualFlight:
    """One flight.

    Args:
        instants: Of the flight.
        design: The same, as features.
        weights: Of the law that is used, per output and feature, shape (6, k); its bounds, which
            no flight that taught it reaches, are left aside.

    Returns:
        Residuals of `FORCES`, by the motion as low-passed as they are.
    """
    left = design.leaves(weights)
    ends = np.flatnonzero(np.diff(design.piece)) + 1
    bounds = zip([0, *ends.tolist()], [*ends.tolist(), len(left)], strict=True)
    spans = tuple((a, b) for a, b in bounds if b - a > 1)
    fresh = np.zeros(left.shape, dtype=np.bool_)
    for a, b in spans:
        fresh[a:b] = True
    return ResidualFlight(
        name=instants.name,
        rate_hz=CHANNEL_HZ,
        t_s=instants.t_s,
        virtual=np.zeros_like(left),
        residual=left,
        fresh=fresh,
        commands=instants.passed[1](instants.motion),
        phase=np.full(len(left), UNKNOWN_PHASE, dtype=np.intp),
        spans=spans,
        channels=FORCES,
    )
