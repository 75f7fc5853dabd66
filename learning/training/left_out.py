"""What a linear prediction leaves of flights that took no part in its fit.

A spread that is told by the samples a prediction was fitted to is too small for any others: on
RflySimDT two such spreads held 56 to 93 % of what a flight left out showed, in place of 95 %.
"""

from collections.abc import Sequence
from typing import Protocol as Interface

import numpy as np
from numpy.typing import NDArray

from ..data.flights import ResidualFlight
from ..data.scaling import Scaling, fit_scaling, in_spans
from ..data.sequences import sequences
from ..model.linear_predictor import fit_base, predict_base
from ..preset import Normalise, Protocol

Array = NDArray[np.float64]


class Normalised(Interface):
    """A preset as far as it says how residuals are scaled."""

    @property
    def normalise(self) -> Normalise:
        """As in `learning.preset.Preset`."""
        ...


def left_out_errors(
    flights: Sequence[ResidualFlight],
    preset: Normalised,
    protocol: Protocol,
    horizon: int,
    scaling: Scaling,
) -> list[Array]:
    """What is left of every span by a prediction and a scaling of the other flights.

    Args:
        flights: Two or more.
        preset: How residuals are scaled.
        protocol: Decides the regressors.
        horizon: Samples, in `track`; else 0.
        scaling: In whose units the errors are told.

    Returns:
        Per span of all flights, in order, shape (n, 15); NaN beyond the envelope of the others,
        where a model of these would correct nothing.
    """
    errors = []
    for one in flights:
        others = [f for f in flights if f is not one]
        theirs = fit_scaling(others, [in_spans(f) for f in others], preset.normalise)
        seen = sequences(others, theirs, protocol, horizon)
        base = fit_base(seen, [s.fresh for s in seen], protocol, one.rate_hz)
        for span in sequences([one], theirs, protocol, horizon):
            left = span.d - predict_base(span, base, protocol, theirs.largest)
            error = left * theirs.scale[span.phase] / scaling.scale[span.phase]
            errors.append(np.where(span.inside[:, None], error, np.nan))
    return errors
