"""The linear prediction alone: scaling, closed form, envelope; no network and no alarm.

    correction = near * (mean + scale * linear prediction)      near: 1 in the envelope, then fading

The same sums as under the network (`learning.model.linear_predictor`), in float64.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..data.channels import CHANNELS, N_PHASES
from ..data.envelope import linear_share
from ..data.flights import ResidualFlight
from ..data.scaling import Scaling, fit_scaling, in_spans
from ..data.sequences import n_regressors, sequences
from ..model.baselines import by_phase
from ..model.corrected import Corrected, between
from ..model.family import Family, Progress, Tensors, TrainingTask, no_alarm
from ..model.info import ModelInfo
from ..model.linear_predictor import fit_base, predict_base
from ..preset import Normalise, Protocol
from ..training.inputs import describe_training
from ..training.left_out import left_out_errors

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class LinearPreset:
    """Hyper-parameters.

    Attributes:
        name: As printed.
        normalise: As in `learning.preset.Preset`.
    """

    name: str = "linear"
    normalise: Normalise = "centred"


@dataclass(frozen=True, slots=True)
class LinearModel:
    """Weights and scaling.

    Attributes:
        info: What it is.
        scaling: Of residuals and features, and the envelope.
        weights: Of the linear prediction, shape (15, regressors).
        expected: Rms of what is to be expected of it, by phase, shape (phases, 15), units of the
            channels: of what the prediction of the other flights leaves of each, where there are
            several.
    """

    info: ModelInfo[LinearPreset]
    scaling: Scaling
    weights: Array
    expected: Array

    @property
    def family(self) -> str:
        """Its row in the registry."""
        return "linear"

    def run(self, flight: ResidualFlight) -> Corrected:
        """The whole flight; each span starts at the state zero."""
        self.info.check_flight(flight)
        correction = np.zeros(flight.virtual.shape)
        spread = np.tile(self.scaling.rms, (len(correction), 1))
        inside = np.zeros(len(correction), dtype=np.bool_)
        protocol, horizon = self.info.protocol, self.info.horizon
        for span in sequences([flight], self.scaling, protocol, horizon):
            phase, near = span.phase, linear_share(span.distance)[:, None]
            linear = predict_base(span, self.weights, protocol, self.scaling.largest)
            about = self.scaling.mean[phase] + self.scaling.scale[phase] * linear
            correction[span.rows] = near * about
            spread[span.rows] = between(near, self.expected[phase], spread[span.rows])
            inside[span.rows] = span.inside
        return Corrected(correction, spread, no_alarm(len(correction)), inside)

    def tensors(self) -> Tensors:
        """Weights, expected spread and scaling."""
        return {
            "weights": self.weights,
            "expected": self.expected,
            **{f"scaling.{name}": values for name, values in self.scaling.arrays().items()},
        }

    def details(self) -> Mapping[str, Any]:
        """Nothing more."""
        return {}


class Linear(Family[LinearPreset, LinearModel]):
    """Autoregression straight to the horizon, or ridge regression on the twin's readings."""

    def presets(self) -> Mapping[str, LinearPreset]:
        """One."""
        return {"linear": LinearPreset()}

    def protocols(self, preset: LinearPreset) -> Sequence[Protocol]:
        """Not `reconstruct`: given the answer there is nothing to predict."""
        return ("track", "free")

    def fit(
        self,
        flights: Sequence[ResidualFlight],
        preset: LinearPreset,
        task: TrainingTask,
        folder: Path,
        progress: Progress,
    ) -> LinearModel:
        """Closed form; ridge and worth chosen by folds, as under the network."""
        info = describe_training("linear", flights, preset, task)
        usable = [in_spans(f) for f in flights]
        scaling = fit_scaling(flights, usable, preset.normalise)
        spans = sequences(flights, scaling, task.protocol, task.horizon)
        weights = fit_base(spans, [s.fresh for s in spans], task.protocol, info.rate_hz)
        model = LinearModel(info, scaling, weights, np.zeros((N_PHASES, len(CHANNELS))))
        left = [f.residual - model.run(f).correction for f in flights]
        if len(flights) > 1:
            unseen = left_out_errors(flights, preset, task.protocol, task.horizon, scaling)
            for span, error in zip(spans, unseen, strict=True):
                told = np.isfinite(error)
                rows = left[span.flight][span.rows]
                rows[told] = (error * scaling.scale[span.phase])[told]
        return replace(model, expected=np.sqrt(by_phase(flights, [e**2 for e in left])))

    def build(self, info: ModelInfo[LinearPreset], tensors: Tensors) -> LinearModel:
        """The model of these numbers."""
        names = Scaling.__dataclass_fields__
        scaling = Scaling(**{name: tensors[f"scaling.{name}"] for name in names})
        weights, expected = tensors["weights"], tensors["expected"]
        wanted = (len(CHANNELS), n_regressors(info.protocol, len(scaling.least)))
        if weights.shape != wanted or expected.shape != scaling.mean.shape:
            raise ValueError(f"weights of shape {weights.shape}, not {wanted}")
        return LinearModel(info, scaling, weights, expected)

    def export(self, model: LinearModel, folder: Path) -> tuple[str, ...]:
        """None: the ONNX graph is written for the network only."""
        return ()
