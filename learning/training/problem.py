"""Data of a training: standardised sequences, linear prediction, calibration."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch
from numpy.typing import NDArray

from ..data.channels import CHANNELS, N_PHASES
from ..data.clustering import clusters_of
from ..data.envelope import UNLIMITED
from ..data.flights import ResidualFlight
from ..data.scaling import in_spans, phase_mean
from ..data.sequences import sequences
from ..model.compensator import Compensator, ModelInfo
from ..model.linear import (
    fit_base,
    gates,
    left_out_errors,
    predict_base,
    scaling_for,
    time_blocks,
    to_learn,
)
from ..model.network import SvqNetwork
from ..preset import Preset, Protocol
from .windows import MANY_FLIGHTS, TrainingSamples, validation_rows

Array = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

INNOVATION_QUANTILE = 0.999
"""Quantile of the innovation per channel that sets its alarm level; any of many channels raises an
alarm. Not chosen on flights."""
ROUNDING = 10 * float(np.finfo(np.float32).eps)
"""Relative rounding error of a model in float32."""


class TrainingProblem:
    """A model and its training data; closed-form solutions are computed at construction.

    Args:
        flights: Training flights, some of them or parts used for validation.
        preset: Hyper-parameters.
        protocol: Protocol: which measurements the model sees.
        horizon: Age of the newest residual, samples, in `track`; otherwise 0.
        seed: Random seed of the validation split and of the clusters.

    Attributes:
        preset: Preset as given, without options that the protocol does not allow.
        seed: Random seed as given.
        compensator: Compensator, whose network is to be trained; `calibrate` completes it.
        unseen: Errors of the linear prediction of the other flights in each span; None for a single
            flight, and without linear prediction.
        samples: Windows for the training.
    """

    def __init__(
        self,
        flights: Sequence[ResidualFlight],
        preset: Preset,
        protocol: Protocol,
        horizon: int,
        seed: int,
    ) -> None:
        self.preset, self.seed = preset, seed
        # `free` sees no measurement, so what it learns of one flight is worth what others say of it
        least = 2 if protocol == "free" else MANY_FLIGHTS
        held_back = validation_rows(flights, preset.validation_share, seed, least)
        usable = [in_spans(f) for f in flights]
        clusters = clusters_of(preset, flights, usable, seed)
        rate_hz, n_commands = flights[0].rate_hz, flights[0].commands.shape[1]
        self.compensator = Compensator(
            ModelInfo(preset, protocol, horizon, rate_hz, n_commands, clusters, seed)
        )
        scaling = scaling_for(flights, preset.normalise, protocol)
        self.compensator.set_scaling(scaling)
        size = 1 + (np.abs(scaling.mean) + np.abs(scaling.reading)) / scaling.scale
        self.least = ROUNDING * size  # of a spread, (phases, 15)
        self.spans = sequences(flights, self.compensator.scaling(), protocol, horizon)
        held = [held_back[s.flight][s.rows, None] for s in self.spans]
        self.train = [s.fresh & ~h for s, h in zip(self.spans, held, strict=True)]
        self.validate = [s.fresh & h for s, h in zip(self.spans, held, strict=True)]
        self.measured = np.any([m.any(0) for m in self.train], axis=0)  # (15,)
        base = np.zeros(tuple(self.compensator.base.shape))
        if preset.linear:
            base = fit_base(self.spans, [s.fresh for s in self.spans], protocol, rate_hz)
        self.compensator.base.copy_(torch.from_numpy(base))
        targets = to_learn(self.spans, [s.fresh for s in self.spans], protocol)
        self.left = [
            target - predict_base(s, base, protocol, scaling.largest)
            for s, target in zip(self.spans, targets, strict=True)
        ]
        self.leftover = np.ones(len(CHANNELS))
        if protocol != "reconstruct":
            square = _mean_square(self.left, self.train)
            self.leftover = np.where(square > 0, np.sqrt(square), 1.0)
            # what a linear prediction leaves of a residual changed at will is not known
            self.preset = replace(preset, augment=0.0)
        self.compensator.leftover.copy_(torch.from_numpy(self.leftover))
        self.unseen: list[Array] | None = None
        if len(flights) > 1 and protocol != "reconstruct" and preset.linear:
            self.unseen = left_out_errors(flights, preset.normalise, protocol, horizon, scaling)
        self.samples = TrainingSamples(
            self.spans, [e / self.leftover for e in self.left], self.train
        )

    @property
    def network(self) -> SvqNetwork:
        """The network to be trained, for a preset with one."""
        assert self.compensator.network is not None
        return self.compensator.network

    def validation_error(self) -> float:
        """Standardised mean square error on the validation data, mean over the channels."""
        errors = [
            left / self.leftover - out.y.double().numpy()
            for left, out in zip(self.left, self.compensator.outputs(self.spans), strict=True)
        ]
        square = _mean_square(errors, self.validate)
        known = np.any([m.any(0) for m in self.validate], axis=0)
        return float(square[known].mean()) if known.any() else math.nan

    def calibrate(self) -> None:
        """Compute gates, spreads and the alarm level from flights left out or validation data."""
        model = self.compensator
        phases = np.concatenate([s.phase for s in self.spans])
        trained = phases[np.concatenate(self.train).any(1)]
        if model.network is not None:
            model.network.fill_unseen([bool(np.any(trained == p)) for p in range(N_PHASES)])
        outs = model.outputs(self.spans)
        y = np.concatenate([self.leftover * o.y.double().numpy() for o in outs])
        left, validate = np.concatenate(self.left), np.concatenate(self.validate)
        gate = self.measured.astype(np.float64)
        if model.info.protocol != "reconstruct":
            gate *= gates(y, left, validate, time_blocks(self.spans, model.info.rate_hz))
            if model.network is not None and not gate.any():
                model.drop_network()
                outs, y = model.outputs(self.spans), np.zeros_like(y)
        model.gate.copy_(torch.from_numpy(gate))
        self.error_without = _mean_square([left], [validate])
        self.error_with = _mean_square([left - gate * y], [validate])
        error, used = self._calibration_errors(left - gate * y, validate)
        alone = np.concatenate([s.alone for s in self.spans])[:, None]
        used &= ~alone | alone.all()  # spreads refer to a twin that follows the motion
        log_spread = np.concatenate([o.log_spread.double().numpy() for o in outs])
        error = error * np.exp(-log_spread)
        rms = np.sqrt(phase_mean(error**2, used, phases))
        factor = np.where(used.any(axis=0), np.maximum(rms, self.least), 0)
        model.spread_factor.copy_(torch.from_numpy(factor))
        if model.info.protocol == "track":
            known = np.where(factor > 0, factor, 1.0)[phases]
            level = self._innovation_level(error / known, used)
            model.anomaly_scale.copy_(torch.from_numpy(level))

    def _calibration_errors(self, error: Array, validate: BoolArray) -> tuple[Array, BoolArray]:
        """Errors for the calibration of spreads, and which of them count, shape (n, 15) both.

        Those on validation data; with several flights, the cross-validated errors of the linear
        prediction minus the improvement by the network on validation data, except for channels
        without such data inside the envelope of the others.
        """
        held_back = np.where(validate.any(0), validate, np.concatenate(self.train))
        if self.unseen is None:
            return error, held_back
        unseen = np.concatenate(self.unseen)
        fresh = np.concatenate([s.fresh for s in self.spans]) & np.isfinite(unseen)
        known = self.error_without > 0
        saved = np.ones(len(known))
        saved[known] = np.sqrt(self.error_with[known] / self.error_without[known])
        left_out = fresh.any(axis=0)
        used = np.where(left_out, fresh, held_back)
        return np.where(left_out, np.nan_to_num(unseen) * saved, error), used

    def _innovation_level(self, error: Array, used: BoolArray) -> Array:
        """Innovation that one reading in a thousand exceeds, in the flight with the largest one, at
        least one spread, with the reserve of the envelope for the next flight; shape (15,),
        `UNLIMITED` for a channel without data.

        Args:
            error: Error over its spread, shape (n, 15).
            used: Samples that count, shape (n, 15).
        """
        of = np.concatenate([np.full(len(s.d), s.flight) for s in self.spans])
        flights = np.unique(of)
        level = np.ones(error.shape[1])
        for flight in flights:
            counts = used & (of == flight)[:, None]
            for c in np.flatnonzero(counts.any(axis=0)):
                usual = np.quantile(np.abs(error[counts[:, c], c]), INNOVATION_QUANTILE)
                level[c] = max(level[c], float(usual))
        return np.where(used.any(axis=0), level * (1 + 1 / len(flights)), UNLIMITED)

    def validation_mse(self) -> dict[str, dict[str, float]]:
        """Mean square error of the linear prediction and with the network, per channel."""
        rows = zip(CHANNELS, self.error_without, self.error_with, strict=True)
        return {n: {"linear": float(a), "with_network": float(b)} for n, a, b in rows}


def _mean_square(errors: Sequence[Array], scored: Sequence[BoolArray]) -> Array:
    """Mean square per channel over all spans, 0 without samples, shape (15,)."""
    error, count = np.concatenate(errors), np.concatenate(scored)
    return np.asarray(np.sum(error**2, axis=0, where=count) / np.maximum(count.sum(0), 1))
