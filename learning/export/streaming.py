"""`Compensator.run` as a self-contained ONNX model: one sample per call, all memory in `state`.

    virtual (B, 15), command (B, m), phase (B, 1), measured (B, 15), valid (B, 15), state (B, N)
    -> correction (B, 15), spread (B, 15), anomaly (B, 1), inside (B, 1), state_out (B, N)

The first axis, "batch", is dynamic: B aircraft in parallel, each with its own state. `measured` is
used where `valid` is 1: there it is new. A sample with a non-finite number is ignored: no
correction, not inside, and an unchanged state.

Few and wide operators, since calls dominate the time of a small network: all clusters are one
batched product. Each cluster has all channels as inputs, with zero weights for those of others;
everything that depends only on the phase (its embedding, all biases) is one table; output scales
are part of the last weights. LSTM cells are written as elementary operators, which any runtime, the
C generator and the int8 quantiser support.
"""

from collections.abc import Sequence

import numpy as np
import onnx
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from ..data.channels import CHANNELS, FEATURE_CHANNELS, N_PHASES, PLACES
from ..data.envelope import BEYOND, LINEAR_BEGIN, LINEAR_END, NETWORK_END
from ..data.sequences import (
    LAGS,
    MEAN_SIZE,
    OF_THE_DAY,
    SMOOTHING_S,
    error_memory,
    limited,
    running_mean,
    smoothing,
)
from ..model.compensator import NO_SPREAD, Compensator
from ..model.network import LOG_SPREAD_LIMIT, ClusterNetwork, LstmStack
from .graph import Graph, Value

Array = NDArray[np.float64]

INPUTS = ("virtual", "command", "phase", "measured", "valid", "state")
"""Inputs of the ONNX model, in order."""
OUTPUTS = ("correction", "spread", "anomaly", "inside", "state_out")
"""Outputs of the ONNX model, in order."""
_N = len(CHANNELS)


def streaming_model(compensator: Compensator, batch: int | None = None) -> onnx.ModelProto:
    """The checked ONNX model without metadata; the same bytes for the same weights.

    Args:
        compensator: Trained compensator.
        batch: Number of samples per call; None: any number.
    """
    info = compensator.info
    graph = Graph("compensator", batch)
    with torch.no_grad():
        _Step(graph, compensator).write()
    return graph.model(
        f"Correction of the virtual sensors of a multirotor's twin, protocol {info.protocol}, "
        f"{info.rate_hz:g} samples a second, state zero at the start."
    )


class _Step:
    """Operators of one sample of `Compensator.run`.

    Attributes:
        state: Parts of the state, as `Compensator.state_sizes`, that are not empty; each is
            replaced by its next value.
        whole: Whether every number of the sample is finite, Boolean of shape (B, 1). Otherwise
            `sample`, its inputs by name, is zero.
        mean, scale, reading, expected: Tables of the phase, shape (B, 15).
    """

    def __init__(self, g: Graph, model: Compensator) -> None:
        self.g, self.model, self.protocol = g, model, model.info.protocol
        self.base, self.horizon = numbers(model.base), model.info.horizon
        sizes, state_size = model.state_sizes, model.state_size
        widths = dict(zip(INPUTS, [_N, model.info.n_commands, 1, _N, _N, state_size], strict=True))
        given = {name: g.input(name, width) for name, width in widths.items()}
        self.before = given.pop("state")
        self.state = g.parts(self.before, sizes)
        with g.scope("inputs"):
            if self.protocol == "free":
                given = {name: given[name] for name in INPUTS[:3]}
            else:
                new = given["valid"] > 0.5
                given["measured"] = g.op("Where", new, given["measured"], given["virtual"])
            row, own = g.concat(*given.values(), axis=1), {name: widths[name] for name in given}
            lost = g.op("IsNaN", row - row).floats().largest(1)  # infinite numbers give NaN, too
            self.whole = lost < 0.5
            row = g.op("Where", self.whole, row, np.zeros(sum(own.values())))
            self.sample = g.parts(row, own)
            code = g.op("Clip", self.sample["phase"], g.floats(0.0), g.floats(N_PHASES - 1))
            away = g.op("Abs", code - np.arange(N_PHASES))
            self.here = g.op("Relu", g.op("Sub", 1.0, away))  # one-hot phase, (B, phases)
            mean, scale, reading = (numbers(t) for t in (model.mean, model.scale, model.reading))
            expected = np.abs(scale) * numbers(model.spread_factor)
            tables = self.here @ np.hstack([mean, scale, reading, expected])
            parts = g.split(tables, [_N] * 4, axis=1)
            self.mean, self.scale, self.reading, self.expected = parts

    def write(self) -> None:
        """Add everything from the inputs to the outputs."""
        g, model = self.g, self.model
        nothing, silent = np.zeros((1, _N)), 0.0
        with g.scope("features"):
            if self.protocol != "reconstruct":  # which uses no feature
                both = g.concat(self.sample["virtual"], self.sample.get("command"), axis=1)
                places = [*FEATURE_CHANNELS, *range(_N, _N + model.info.n_commands)]
                raw = both.gather(*places)
                self.features = (raw - model.feature_mean) / model.feature_scale
                self.features = self.features.clip(model.least, model.most)
            if model.history:
                self.state["past"] = self._remembered()
            if self.protocol != "reconstruct":  # otherwise their state stays as it is
                shares = np.repeat(smoothing(model.info.rate_hz), len(model.features))
                slow = self.state["slow"]
                away = g.concat(self.features, self.features, axis=1) - slow
                self.state["slow"] = slow + g.op("Mul", shares, away)
            if model.history:
                past, first = self.state["past"], self.horizon * _N
                self.known = past if model.history == 1 else past.columns(first, first + _N)
        more = log_spread = None
        if model.network is not None:
            more, log_spread = self._network()
        with g.scope("envelope"):
            if limited(self.protocol):
                self.distance = self._distance(raw)
        with g.scope("linear"):
            linear = self._linear()
        with g.scope("envelope"):
            more = None if more is None else self.scale * more
            expected, inside = self.expected, self.whole
            if log_spread is not None:
                expected = expected * g.op("Exp", log_spread)
            rms = g.floats(numbers(model.rms)[None])
            if limited(self.protocol):
                close = self._fade(1.0, NETWORK_END)
                linear = linear * self._fade(LINEAR_BEGIN, LINEAR_END)
                more = None if more is None else more * close
                expected = rms + close * (expected - rms)
                inside = g.op("And", self.whole, self.distance <= 1.0)
            correction = linear if more is None else linear + more
        g.output("correction", _N, "Where", self.whole, correction, nothing)
        today, alarm = expected, None
        if self.protocol == "track":
            with g.scope("spread"):
                fresh = self.sample["valid"] > 0.5
                size = g.op("Abs", self._residual() - correction)
                size = size / g.op("Max", expected, NO_SPREAD)
                error = self._error_of_today(g.op("Where", fresh, size, nothing))
                today = expected * (close * (error - 1.0) + 1.0)
        g.output("spread", _N, "Where", self.whole, today, rms)
        with g.scope("alarm"):
            if self.protocol == "track":
                ratio = size / model.anomaly_scale
                self.state["ratios"] = g.op("Where", fresh, ratio, self.state["ratios"])
                alarm = self.state["ratios"].largest(1)
            else:
                alarm = self.sample["phase"] * silent  # 0 of shape (B, 1): it has none
        g.output("anomaly", 1, "Where", self.whole, alarm, silent)
        g.output("inside", 1, "Cast", inside, to=onnx.TensorProto.FLOAT)
        later = g.concat(*self.state.values(), axis=1)
        g.output("state_out", model.state_size, "Where", self.whole, later, self.before)

    def _residual(self) -> Value:
        """Measured minus virtual, shape (B, 15)."""
        return self.sample["measured"] - self.sample["virtual"]

    def _remembered(self) -> Value:
        """Standardised residuals with the present one first, newest first, shape (B, rows 15)."""
        rows, past = self.model.history, self.state["past"]
        new = (self._residual() - self.mean) / self.scale
        fresh = self.sample["valid"] > 0.5
        held = self.g.op("Where", fresh, new, past if rows == 1 else past.columns(0, _N))
        if rows == 1:
            return held
        return self.g.concat(held, past.columns(0, (rows - 1) * _N), axis=1)

    def _linear(self) -> Value:
        """Mean and linear prediction in units of the channels, shape (B, 15)."""
        g, base, virtual = self.g, self.base, self.sample["virtual"]
        if self.protocol == "reconstruct":
            return self.mean
        inputs = g.op("Concat", self.features, self.state["slow"], axis=1)
        said = inputs @ base[:, -len(self.model.features) * (1 + len(SMOOTHING_S)) :].T
        own, newest = (virtual - self.reading) / self.scale, None
        if self.protocol == "free":
            said = self._beyond(said + own * base[:, :1].T)
        else:
            rows, known = self.model.history, self.known
            lags = self.state["past"].columns(self.horizon * _N, rows * _N).reshape(0, -1, _N)
            change = (self._read_then() - virtual) / self.scale
            offset = self._offset(known + (change + own))
            mean_residual = offset.columns(0, 1)
            about, newest = lags - mean_residual, mean_residual.reshape(0, _N)
            each = [v.reshape(0, 1, _N) for v in (change, own)]
            seen = g.concat(about, offset, *each, axis=1)  # (B, lags + 4, 15)
            said = said + (seen * base[:, : LAGS + 4].T).sum(1, keep=0)
        most = BEYOND * numbers(self.model.largest)  # as `learning.model.linear.bounded`
        about = (said if newest is None else said - newest).clip(-most, most)
        return self.mean + self.scale * (about if newest is None else newest + about)

    def _read_then(self) -> Value:
        """The twin's reading at the newest known residual, shape (B, 15)."""
        g, last = self.g, self.horizon
        started = (self.state["begun"] > 0.5).reshape(0, 1, 1)
        virtual = self.sample["virtual"].reshape(0, 1, _N)
        rows = g.op("Where", started, self.state["readings"].reshape(0, -1, _N), virtual)
        newest = rows.columns(0, 1)  # of (B, readings, 15)
        fresh = (self.sample["valid"] > 0.5).reshape(0, 1, _N)
        newest = g.op("Where", fresh, virtual, newest)
        rows = g.concat(newest, rows.columns(0, last), axis=1)
        then = rows.columns(last, last + 1).reshape(0, _N)
        self.state["readings"] = rows.reshape(0, -1)
        self.state["begun"] = g.op("Max", self.state["begun"], 1.0)
        return then

    def _mean_so_far(self, new: Value) -> Value:
        """Sums and weights of the running means, with new values."""
        decay, _ = running_mean(self.model.info.rate_hz)
        self.state["means"] = self.state["means"] * decay + new
        return self.state["means"]

    def _offset(self, read: Value) -> Value:
        """Running means of the known residual and reading, shape (B, 2, 15)."""
        g, known = self.g, self.known
        there = (g.op("Abs", known) > 0.0).floats()
        sums = self._mean_so_far(g.concat(known, read * there, there, axis=1))
        sums, weights = g.split(sums, [2 * _N, _N], axis=1)
        weights = weights + running_mean(self.model.info.rate_hz)[1]
        return sums.reshape(0, 2, _N) / weights.reshape(0, 1, _N)

    def _beyond(self, said: Value) -> Value:
        """Linear predictions, for the sensors of `OF_THE_DAY` minus their running means, which
        equals the prediction from inputs minus their means, shape (B, 15)."""
        g = self.g
        counts = (self.distance <= 1.0).floats()
        sums = self._mean_so_far(g.concat(said * counts, counts, axis=1))
        sums, weight = g.split(sums, [_N, 1], axis=1)
        away = (said * weight - sums) / g.op("Max", weight, 1.0)
        of_the_day = g.floats(OF_THE_DAY[None])
        others = said * g.op("Sub", 1.0, of_the_day)
        return others + away * of_the_day

    def _error_of_today(self, new: Value) -> Value:
        """Size of the current flight's errors over the spread, shape (B, 15).

        Args:
            new: Size of the present innovations, 0 where there is none, shape (B, 15).
        """
        g, last, sizes = self.g, (self.horizon - 1) * _N, self.state["sizes"]
        known = sizes.columns(last, last + _N)
        there = (known > 0.0).floats()
        known = known / MEAN_SIZE
        decay = g.floats([[error_memory(self.model.info.rate_hz)]])
        self.state["errors"] = self.state["errors"] * decay + g.concat(known, there, axis=1)
        sums, weights = g.split(self.state["errors"] + 1.0, [_N, _N], axis=1)
        earlier = sizes.columns(0, last) if last else None
        error = sums / weights
        self.state["sizes"] = g.concat(new, earlier, axis=1)
        return error

    def _distance(self, raw: Value) -> Value:
        """Distance from the training data, shape (B, 1)."""
        g, model, parts = self.g, self.model, []
        for some in PLACES:
            own = raw.gather(*some)
            parts.append(own if len(some) == 1 else g.op("Sqrt", (own * own).sum(1)))
        first = len(FEATURE_CHANNELS)
        drives = raw.columns(first, first + model.info.n_commands)
        centred = g.concat(*parts, drives, axis=1) - model.place_centre
        whitening = numbers(model.place_whitening) / numbers(model.place_scale)
        spread = numbers(model.place_reach) * np.sqrt(len(whitening))
        white = centred @ (whitening / spread).T
        return g.op("Sqrt", (white * white).sum(1))

    def _fade(self, begin: float, end: float) -> Value:
        """Fade-out, as in `learning.data.envelope`, shape (B, 1)."""
        t = ((self.distance - begin) / (end - begin)).clip(0.0, 1.0)
        rest = self.g.op("Sub", 3.0, t + t)
        return self.g.op("Sub", 1.0, t * t * rest)

    def _network(self) -> tuple[Value, Value | None]:
        """Output times its gain, and its log spread, None without a spread head, shape (B, 15)."""
        g, model, network, preset = self.g, self.model, self.model.network, self.model.info.preset
        assert network is not None
        clusters = [n for n in network.networks if isinstance(n, ClusterNetwork)]
        units = [*preset.encoder_units, *preset.decoder_units]
        with g.scope("cells"):
            cells = self.state["cells"].reshape(0, len(clusters), -1)
            parts = g.split(cells.transpose(1, 0, 2), [u for u in units for _ in range(2)], axis=2)
        states = list(zip(parts[::2], parts[1::2], strict=True))  # (C, B, units) each
        n_encoder = len(preset.encoder_units)
        with g.scope("encoder"):
            known = self.known if network.sees_known else None
            features = self.features if network.sees_features else None
            seen = g.concat(known, features, self.here, axis=1)
            tables = np.stack([_seen_table(model, i) for i in range(len(clusters))])
            gates, through = g.split(seen @ tables, [4 * units[0], preset.code_size], axis=2)
            h, encoded = _lstm([c.encoder for c in clusters], gates, None, 0, states[:n_encoder])
            to_latent = np.stack([numbers(c.to_latent.weight).T * _closeness(c) for c in clusters])
            with g.scope("to_latent"):
                z = h @ to_latent + through
        with g.scope("quantiser"):
            code = self._quantised(clusters, z)
        with g.scope("decoder"):
            embedding = numbers(network.phase_embedding)
            gates = self.here @ np.stack([_phase_table(c.decoder, embedding) for c in clusters])
            decoders, size = [c.decoder for c in clusters], preset.code_size
            h, decoded = _lstm(decoders, gates, code, size, states[n_encoder:])
        with g.scope("read_out"):
            y, log_spread = self._read_out(clusters, h, code)
        with g.scope("cells"):
            after = g.concat(*(v for pair in (*encoded, *decoded) for v in pair), axis=2)
            self.state["cells"] = _side_by_side(after)
        return y, log_spread

    def _quantised(self, clusters: Sequence[ClusterNetwork], z: Value) -> Value:
        """Code of a latent, shape (C, B, D)."""
        preset = self.model.info.preset
        if preset.quantiser == "none":
            return z * self.g.floats(preset.temperature / 2)
        codes = np.stack([numbers(c.quantiser.codes) for c in clusters])  # (C, K, D)
        book = self.g.floats(codes)  # one constant for both products, stored once
        logits = (book @ z.transpose(0, 2, 1)).transpose(0, 2, 1)  # (C, B, K)
        logits = logits - (codes**2).sum(-1)[:, None] / preset.temperature
        if preset.quantiser == "soft":
            return self.g.op("Softmax", logits, axis=2) @ book
        nearest = self.g.op("Equal", logits, logits.largest(2)).floats()
        return nearest / nearest.sum(2) @ book

    def _read_out(
        self, clusters: Sequence[ClusterNetwork], h: Value, code: Value
    ) -> tuple[Value, Value | None]:
        """Output times its gain, and its log spread, None without a spread head, shape (B, 15).

        One product over all clusters' outputs, with zero weights for the channels of others.
        """
        g, preset = self.g, self.model.info.preset
        gain = numbers(self.model.gate * self.model.leftover)
        n, units = len(clusters), preset.decoder_units[-1]
        width = units + (preset.code_size if preset.skip else 0)
        weights, biases = np.zeros((n, width, 2, _N)), np.zeros((2, _N))
        for i, (cluster, own) in enumerate(zip(clusters, self.model.info.clusters, strict=True)):
            places = list(own)
            weights[i, :units, 0, places] = numbers(cluster.to_output.weight)
            biases[0, places] = numbers(cluster.to_output.bias)
            if cluster.skip_out is not None:
                weights[i, units:, 0, places] = numbers(cluster.skip_out.weight)
                biases[0, places] += numbers(cluster.skip_out.bias)
            if cluster.to_spread is not None:
                weights[i, :units, 1, places] = numbers(cluster.to_spread.weight)
                biases[1, places] = numbers(cluster.to_spread.bias)
        weights[:, :, 0] *= gain
        biases[0] *= gain
        given = 2 if preset.spread_head else 1
        seen = _side_by_side(g.concat(h, code, axis=2) if preset.skip else h)
        flat = weights[:, :, :given].reshape(n * width, given * _N)
        row = seen @ flat + biases[:given].reshape(1, -1)
        if not preset.spread_head:
            return row, None
        y, log_spread = g.split(row, [_N, _N], axis=1)
        limits = g.floats(-LOG_SPREAD_LIMIT), g.floats(LOG_SPREAD_LIMIT)
        return y, g.op("Clip", log_spread, *limits)


def _side_by_side(of_clusters: Value) -> Value:
    """Outputs of the clusters in one row per sample: (C, B, n) to (B, C n)."""
    return of_clusters.transpose(1, 0, 2).reshape(0, -1)


def _lstm(
    stacks: Sequence[LstmStack],
    gates: Value,
    x: Value | None,
    width: int,
    states: Sequence[tuple[Value, Value]],
) -> tuple[Value, list[tuple[Value, Value]]]:
    """LSTM layers; returns output and next states, shapes (C, B, U).

    Args:
        stacks: LSTM layers of each cluster.
        gates: Gates of the first layer without the contributions of `x` and the state, (C, B, 4 U).
        x: Further input of the first layer, shape (C, B, width); None: none.
        width: Width of `x`.
        states: Output and cell state of each layer.
    """
    g, after = gates.graph, list[tuple[Value, Value]]()
    for number, (h, c) in enumerate(states):
        layers = [_layer(stack, number) for stack in stacks]
        units = layers[0].hidden_size
        weights = [np.vstack([_of_input(k)[:width], _of_state(k)]) for k in layers]
        with g.scope(f"layer_{number}"):
            sums = g.concat(x, h, axis=2) @ np.stack(weights)
            if number:
                gates = g.floats(np.stack([_bias(k)[None] for k in layers]))
            ifo, new = g.split(sums + gates, [3 * units, units], axis=2)
            i, f, o = g.split(g.op("Sigmoid", ifo), [units] * 3, axis=2)
            c = f * c + i * g.op("Tanh", new)
            x, width = o * g.op("Tanh", c), units
        after.append((x, c))
    return after[-1][0], after


# -- weights --------------------------------------------------------------------------------


def _closeness(cluster: ClusterNetwork) -> float:
    """Scale of the graph's latent relative to the network's: its product with a code is a logit."""
    return 2 / cluster.quantiser.temperature


def _seen_table(model: Compensator, number: int) -> Array:
    """Weights from [known residuals, features, phase] to a cluster's gates and latent, (S, 4 U +
    D)."""
    network = model.network
    assert network is not None
    cluster = network.networks[number]
    assert isinstance(cluster, ClusterNetwork)
    n_known = _N if network.sees_known else 0
    n_features = len(model.features) if network.sees_features else 0
    own = network.clusters[number] if network.sees_known else ()
    rows = [*own, *range(n_known, n_known + n_features)]
    gates = _of_input(_layer(cluster.encoder, 0))
    width = gates.shape[1]
    table = np.zeros((n_known + n_features + N_PHASES, width + model.info.preset.code_size))
    table[rows, :width] = gates[: len(rows)]
    table[-N_PHASES:, :width] = _phase_table(cluster.encoder, numbers(network.phase_embedding))
    table[-N_PHASES:, width:] = numbers(cluster.to_latent.bias) * _closeness(cluster)
    if cluster.skip_in is not None:
        table[rows, width:] = numbers(cluster.skip_in.weight).T * _closeness(cluster)
    return table


def _phase_table(stack: LstmStack, embedding: Array) -> Array:
    """Contribution of the phase to the gates of the first layer, including biases, (phases, 4
    U)."""
    layer = _layer(stack, 0)
    return np.asarray(embedding @ _of_input(layer)[-embedding.shape[1] :] + _bias(layer))


def numbers(values: Tensor) -> Array:
    """Values of a tensor, float64."""
    return np.asarray(values.detach().double().numpy())


def _layer(stack: LstmStack, number: int) -> nn.LSTM:
    layer = stack.layers[number]
    assert isinstance(layer, nn.LSTM)
    return layer


def _of_input(layer: nn.LSTM) -> Array:
    """Weights from the input to the gates, shape (inputs, 4 U)."""
    return _gates(layer.all_weights[0][0])


def _of_state(layer: nn.LSTM) -> Array:
    """Weights from the layer's last output to the gates, shape (U, 4 U)."""
    return _gates(layer.all_weights[0][1])


def _bias(layer: nn.LSTM) -> Array:
    """Bias of the gates, shape (4 U,)."""
    return _gates(layer.all_weights[0][2]) + _gates(layer.all_weights[0][3])


def _gates(values: Tensor) -> Array:
    """Gates on the last axis, in the order input, forget, output, new: those with a sigmoid
    first."""
    i, f, new, o = np.split(numbers(values), 4)
    return np.concatenate([i, f, o, new]).T
