"""The compensator: correction of the twin's sensor readings at each sample, with spread and alarm.

    correction = near * (mean + scale * linear prediction) + close * scale * gate * network

`near` and `close` are 1 inside the training envelope and fade outside (`learning.data.envelope`).
The anomaly score is the innovation, a reading minus the corrected twin, over its spread, and over
the size that this ratio reached on flights left out, or on validation data for a single flight.
There is none where no reading is seen (`free`), or the reading is the input to be reproduced
(`reconstruct`).

`Compensator.run` is the definition, over whole flights. In flight the ONNX graph that
`learning.export.streaming` writes is used, with one sample per call and all memory in `state`,
whose layout is defined here; each export contains numbers of `run` for verification.
"""

import copy
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from ..compute import one_thread
from ..data.channels import CHANNELS, N_PHASES
from ..data.envelope import linear_share, network_share
from ..data.flights import ResidualFlight, held
from ..data.scaling import Scaling, feature_names, place_names
from ..data.sequences import (
    SMOOTHING_S,
    SpanSequence,
    check_protocol,
    error_of_today,
    limited,
    n_lags,
    n_regressors,
    one_hot,
    sequences,
)
from ..preset import Preset
from .family import Corrected, ModelInfo, between, no_alarm
from .linear import predict_base
from .network import NetworkOut, SvqNetwork

__all__ = ["LINEAR_PART", "Compensator", "ModelInfo", "network_inputs", "untrained_compensator"]

Array = NDArray[np.float64]
CHUNK = 4096
"""Samples per call of the network in a long flight, to limit memory."""
NO_SPREAD = 1e-12
"""Replaces the spread of a channel without training data, whose level is `UNLIMITED`."""
LINEAR_PART = "linear part alone"
"""Name of `Compensator.without_network` in a table."""


class Compensator(nn.Module):
    """Streaming model; buffers and weights contain everything it needs."""

    if TYPE_CHECKING:

        def __getattr__(self, name: str) -> Tensor:
            """Buffers are tensors."""

    def __init__(self, info: ModelInfo[Preset]) -> None:
        super().__init__()
        check_protocol(info.protocol, info.horizon)
        self.info = info
        self.features = feature_names(info.n_commands)
        """Names of the features, in order."""
        n_channels, n_features = len(CHANNELS), len(self.features)
        n_places = len(place_names(info.n_commands))
        regressors = n_regressors(info.protocol, n_features)
        self.network: SvqNetwork | None = None
        if info.preset.network:
            self.network = SvqNetwork(info.preset, info.protocol, info.clusters, n_features)
        shapes = {
            "mean": (N_PHASES, n_channels),
            "scale": (N_PHASES, n_channels),
            "reading": (N_PHASES, n_channels),
            "largest": (n_channels,),
            "feature_mean": (n_features,),
            "feature_scale": (n_features,),
            "least": (n_features,),
            "most": (n_features,),
            "place_centre": (n_places,),
            "place_scale": (n_places,),
            "place_whitening": (n_places, n_places),
            "place_reach": (1,),
            "rms": (n_channels,),
            "base": (n_channels, regressors),  # weights of the linear prediction
            "leftover": (n_channels,),  # spread of its error: unit of the network's output
            "gate": (n_channels,),
            "spread_factor": (N_PHASES, n_channels),  # calibrates the spread where it is predicted
            "anomaly_scale": (n_channels,),  # anomalous innovation over spread, `track`
        }
        for name, shape in shapes.items():
            self.register_buffer(name, torch.ones(shape))

    @property
    def family(self) -> str:
        """Family of the model in the registry."""
        return "svq" if self.info.preset.network else "linear"

    @property
    def history(self) -> int:
        """Number of past residuals in the state, newest first."""
        lags = n_lags(self.info.protocol)
        return self.info.horizon + lags if lags else 0

    @property
    def state_sizes(self) -> dict[str, int]:
        """Sizes of the parts of the packed state.

        `past`: residuals, newest first; `means`: in `track` sums of the running means of residuals,
        of readings, and weights, in `free` sums of linear predictions, and their weight;
        `readings`: of the twin, at the times of the past residuals; `begun`: 1 once started;
        `ratios`: innovation ratio of the newest reading of each channel; `sizes` of the innovations
        that are not known yet; `errors`: their sums and weights; `slow` features; `cells` of the
        network.
        """
        n, ahead, protocol = len(CHANNELS), self.info.horizon, self.info.protocol
        track = int(protocol == "track")
        return {
            "past": self.history * n,
            "means": {"track": 3 * n, "free": n + 1}.get(protocol, 0),
            "readings": track * (ahead + 1) * n,
            "begun": track,
            "ratios": track * n,
            "sizes": track * ahead * n,
            "errors": track * 2 * n,
            "slow": len(SMOOTHING_S) * len(self.features),
            "cells": self.network.state_size if self.network else 0,
        }

    @property
    def state_size(self) -> int:
        """Size of the packed state."""
        return sum(self.state_sizes.values())

    def set_scaling(self, scaling: Scaling) -> None:
        """Set scaling and envelope."""
        for name, values in scaling.arrays().items():
            getattr(self, name).copy_(torch.from_numpy(values))

    def scaling(self) -> Scaling:
        """Scaling and envelope."""
        names = Scaling.__dataclass_fields__
        return Scaling(**{name: getattr(self, name).double().numpy() for name in names})

    def run(self, flight: ResidualFlight) -> Corrected:
        """Correction of the whole flight; each span starts at zero state.

        Raises:
            ModelError: Rate or number of commands differs from the training.
        """
        self.info.check_flight(flight)
        n = len(flight.t_s)
        correction = np.zeros((n, len(CHANNELS)))
        spread = np.tile(self.rms.double().numpy(), (n, 1))
        anomaly = np.zeros(n) if self.info.protocol == "track" else no_alarm(n)
        inside = np.zeros(n, dtype=np.bool_)
        scaling, base = self.scaling(), self.base.double().numpy()
        gain = (self.gate * self.leftover).double().numpy()
        factor = self.spread_factor.double().numpy()
        for span in sequences([flight], scaling, self.info.protocol, self.info.horizon):
            out = self.outputs([span])[0]
            near, close = linear_share(span.distance), network_share(span.distance)
            mean, scale = scaling.mean[span.phase], scaling.scale[span.phase]
            linear = predict_base(span, base, self.info.protocol, scaling.largest)
            said = mean + scale * linear
            more = scale * gain * out.y.double().numpy()
            correction[span.rows] = near[:, None] * said + close[:, None] * more
            expected = scale * factor[span.phase] * np.exp(out.log_spread.double().numpy())
            spread[span.rows] = between(close[:, None], expected, spread[span.rows])
            if self.info.protocol == "track":
                new = np.nan_to_num(flight.residual[span.rows] - correction[span.rows])
                size = innovation_size(new, spread[span.rows])
                level = self.anomaly_scale.double().numpy()
                anomaly[span.rows] = held(size / level, span.fresh, 0.0).max(axis=1)
                today = error_of_today(size, span.fresh, self.info.horizon, self.info.rate_hz)
                spread[span.rows] *= between(close[:, None], today, np.ones_like(today))
            inside[span.rows] = span.inside
        return Corrected(correction, spread, anomaly, inside)

    @one_thread()
    @torch.no_grad()
    def outputs(self, spans: Sequence[SpanSequence]) -> list[NetworkOut]:
        """Output of the network over each span, from zero state, shapes (n, ...)."""
        if self.network is None:
            nothing = [torch.zeros(len(s.d), len(CHANNELS)) for s in spans]
            return [NetworkOut(zero, zero) for zero in nothing]
        found, device = [], self.network.phase_embedding.device
        for span in spans:
            known, features, phase = (t.to(device) for t in network_inputs(span))
            state = torch.zeros(1, self.network.state_size, device=device)
            parts = []
            for k in range(0, len(span.d), CHUNK):
                rows = slice(k, k + CHUNK)
                out, state = self.network(
                    known[None, rows], features[None, rows], phase[None, rows], state
                )
                parts.append((out.y[0], out.log_spread[0]))
            y, log_spread = (torch.cat(p).cpu() for p in zip(*parts, strict=True))
            found.append(NetworkOut(y, log_spread))
        return found

    def without_network(self) -> "Compensator | None":
        """The model with its gates closed, for comparison with the network; None where there is no
        linear prediction."""
        preset = self.info.preset
        if not (preset.network and preset.linear) or self.info.protocol == "reconstruct":
            return None
        alone = copy.deepcopy(self)
        alone.gate.zero_()
        return alone

    def drop_network(self) -> None:
        """Remove the network and keep the linear prediction, if the network contributes nothing."""
        preset = replace(self.info.preset, encoder_units=(), decoder_units=())
        self.network, self.info = None, replace(self.info, preset=preset)

    @torch.no_grad()
    def shut(self, channels: Sequence[int]) -> None:
        """Disable the correction of some channels; their expected error becomes that of the
        twin."""
        for c in channels:
            for values in (self.gate, self.base):
                values[c] = 0
            self.mean[:, c] = 0
            self.spread_factor[:, c] = self.rms[c] / self.scale[:, c]

    def tensors(self) -> dict[str, NDArray[Any]]:
        """Weights and buffers by name."""
        return {k: v.detach().numpy() for k, v in self.state_dict().items()}

    def details(self) -> dict[str, Any]:
        """The envelope (`learning.data.envelope`); {} without one."""
        if not limited(self.info.protocol):
            return {"envelope": {}}
        said = self.scaling().envelope
        return {
            "envelope": {
                "inputs": list(place_names(self.info.n_commands)),
                "centre": said.centre.tolist(),
                "scale": said.scale.tolist(),
                "whitening": said.whitening.tolist(),
                "reach": said.reach,
            }
        }


def innovation_size(innovation: Array, spread: Array) -> Array:
    """Absolute innovation over its spread, shape (n, 15).

    Args:
        innovation: Reading minus corrected virtual reading, shape (n, 15).
        spread: Predicted spread, shape (n, 15); 0 for a channel without training data.
    """
    return np.asarray(np.abs(innovation) / spread.clip(min=NO_SPREAD))


def untrained_compensator(info: ModelInfo[Preset]) -> Compensator:
    """A model with random weights and the size of a trained one, for speed measurements."""
    torch.manual_seed(0)
    return Compensator(info).eval()


def network_inputs(span: SpanSequence) -> tuple[Tensor, Tensor, Tensor]:
    """Known residuals (n, 15), features (n, F) and one-hot phase (n, phases) of a span, float32."""
    known = span.lags[..., 0] if span.lags.shape[-1] else np.zeros_like(span.d)
    arrays = (known, span.features, one_hot(span.phase))
    known_, features, phase = (torch.from_numpy(a.astype(np.float32)) for a in arrays)
    return known_, features, phase
