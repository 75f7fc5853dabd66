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
from dataclasses import dataclass

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
from ..model.network import LOG_SPREAD_LIMIT, ClusterNetwork, LstmStack, SvqNetwork
from .graph import Graph

Array = NDArray[np.float64]

INPUTS = ("virtual", "command", "phase", "measured", "valid", "state")
"""Inputs of the ONNX model, in order."""
OUTPUTS = ("correction", "spread", "anomaly", "inside", "state_out")
"""Outputs of the ONNX model, in order."""
_FLOAT = onnx.TensorProto.FLOAT  # 32 bits


def streaming_model(compensator: Compensator, batch: int | None = None) -> onnx.ModelProto:
    """The checked ONNX model without metadata; the same bytes for the same weights.

    Args:
        compensator: Trained compensator.
        batch: Number of samples per call; None: any number.
    """
    info = compensator.info
    graph = Graph("compensator", batch)
    n = len(CHANNELS)
    widths = [n, info.n_commands, 1, n, n, compensator.state_size]
    for name, width in zip(INPUTS, widths, strict=True):
        graph.input(name, width)
    with torch.no_grad():
        _step(graph, compensator)
    return graph.model(
        f"Correction of the virtual sensors of a multirotor's twin, protocol {info.protocol}, "
        f"{info.rate_hz:g} samples a second, state zero at the start."
    )


@dataclass(frozen=True)
class _Sample:
    """Names of the inputs, set to zero where any number is not finite.

    Attributes:
        whole: Whether every number is finite, Boolean of shape (B, 1).
        measured: Name of the measurements, "" where none is used, as `valid`.
    """

    whole: str
    virtual: str
    command: str
    phase: str
    measured: str = ""
    valid: str = ""


def _sample(g: Graph, model: Compensator) -> _Sample:
    n = len(CHANNELS)
    names, widths = ["virtual", "command", "phase"], [n, model.info.n_commands, 1]
    if model.info.protocol != "free":
        fresh = g.op("Greater", "valid", g.floats([[0.5]]))
        names += [g.op("Where", fresh, "measured", "virtual"), "valid"]
        widths += [n, n]
    given = g.concat(*names, axis=1)
    none = g.op("IsNaN", g.op("Sub", given, given))  # infinite numbers give NaN, too
    lost = g.op("ReduceMax", g.op("Cast", none, to=_FLOAT), axes=[1], keepdims=1)
    whole = g.op("Less", lost, g.floats([[0.5]]))
    parts = g.split(g.op("Where", whole, given, g.floats([np.zeros(sum(widths))])), widths, axis=1)
    return _Sample(whole, *parts)


def _step(g: Graph, model: Compensator) -> None:
    """Operators of one sample of `Compensator.run`."""
    rows, protocol, n = model.history, model.info.protocol, len(CHANNELS)
    parts = g.split("state", list(model.state_sizes), axis=1)
    past, mean_so_far, readings, begun, innovation_ratios, sizes, errors, slow, cells = parts
    with g.scope("inputs"):
        sample = _sample(g, model)
        here = _one_hot(g, sample)
        mean, scale, reading, expected = _tables(g, model, here)
    sees_inputs = protocol != "reconstruct"  # which uses no feature
    with g.scope("features"):
        raw = _raw_features(g, model, sample) if sees_inputs else ""
        features = _features(g, model, raw) if sees_inputs else ""
        if rows:
            past = _remembered(g, sample, past, mean, scale, (rows, n))
        if sees_inputs:  # otherwise they are unused, and their state stays as it is
            slow = _smoothed(g, model, features, slow)
        first = model.info.horizon * n
        known = past if rows <= 1 else g.columns(past, first, first + n)
    y, log_spread = "", ""
    if model.network is not None:
        y, log_spread, cells = network(g, model, known, features, here, cells)

    with g.scope("envelope"):
        distance = _distance(g, model, raw) if limited(protocol) else ""
    said, today, base = "", "", numbers(model.base)
    with g.scope("linear"):
        if sees_inputs:
            inputs = g.op("Concat", features, slow, axis=1)
            of_inputs = base[:, -len(model.features) * (1 + len(SMOOTHING_S)) :]
            said = g.op("MatMul", inputs, g.floats(of_inputs.T))
            own = g.op("Div", g.op("Sub", sample.virtual, reading), scale)
        if protocol == "free":
            said = g.op("Add", said, g.op("Mul", own, g.floats(base[:, :1].T)))
            said, mean_so_far = _beyond(g, model, said, distance, mean_so_far)
        if protocol == "track":
            lags = g.reshape(g.columns(past, first, rows * n), 0, -1, n)  # (B, lags, 15)
            then, readings, begun = _read_then(g, model, sample, readings, begun)
            change = g.op("Div", g.op("Sub", then, sample.virtual), scale)
            read = g.op("Add", known, g.op("Add", change, own))
            offset, mean_so_far = _offset(g, model, known, read, mean_so_far)
            newest = g.op("Slice", offset, g.integers(0), g.integers(1), g.integers(1))
            about, today = g.op("Sub", lags, newest), g.reshape(newest, 0, n)
            each = (g.reshape(v, 0, 1, n) for v in (change, own))
            seen = g.concat(about, offset, *each, axis=1)  # (B, lags + 4, 15)
            products = g.op("Mul", seen, g.floats(base[:, : LAGS + 4].T))
            said = g.op("Add", said, g.op("ReduceSum", products, g.integers(1), keepdims=0))
        linear = mean
        if said:
            linear = g.op("Add", mean, g.op("Mul", scale, _bounded(g, model, said, today)))
    with g.scope("envelope"):
        more = g.op("Mul", scale, y) if y else ""
        if log_spread:
            expected = g.op("Mul", expected, g.op("Exp", log_spread))
        inside, rms = sample.whole, g.floats(_row(model.rms))
        if limited(protocol):
            close = _fade(g, distance, 1.0, NETWORK_END)
            linear = g.op("Mul", linear, _fade(g, distance, LINEAR_BEGIN, LINEAR_END))
            more = g.op("Mul", more, close) if more else ""
            expected = g.op("Add", rms, g.op("Mul", close, g.op("Sub", expected, rms)))
            within = g.op("LessOrEqual", distance, g.floats([[1.0]]))
            inside = g.op("And", sample.whole, within)
        correction = g.op("Add", linear, more) if more else linear
        nothing, silent = g.floats(np.zeros((1, n))), g.floats([[0.0]])
    g.output("correction", n, "Where", sample.whole, correction, nothing)
    today = expected
    if protocol == "track":
        with g.scope("spread"):
            fresh = g.op("Greater", sample.valid, g.floats([[0.5]]))
            size = _innovation_size(g, sample, correction, expected)
            new = g.op("Where", fresh, size, nothing)
            error, sizes, errors = _error_of_today(g, model, new, sizes, errors)
            more = g.op("Mul", close, g.op("Sub", error, g.floats([[1.0]])))
            today = g.op("Mul", expected, g.op("Add", more, g.floats([[1.0]])))
    g.output("spread", n, "Where", sample.whole, today, rms)
    with g.scope("alarm"):
        if protocol == "track":
            ratio = g.op("Div", size, g.floats(_row(model.anomaly_scale)))
            innovation_ratios = g.op("Where", fresh, ratio, innovation_ratios)
            alarm = g.op("ReduceMax", innovation_ratios, axes=[1], keepdims=1)
        else:
            alarm = g.op("Mul", sample.phase, silent)  # 0 of shape (B, 1): it has none
    g.output("anomaly", 1, "Where", sample.whole, alarm, silent)
    g.output("inside", 1, "Cast", inside, to=_FLOAT)
    compared = (innovation_ratios, sizes, errors)
    later = g.concat(past, mean_so_far, readings, begun, *compared, slow, cells, axis=1)
    g.output("state_out", model.state_size, "Where", sample.whole, later, "state")


def _one_hot(g: Graph, sample: _Sample) -> str:
    """One-hot code of the phase, shape (B, phases)."""
    code = g.op("Clip", sample.phase, g.floats(0.0), g.floats(N_PHASES - 1))
    away = g.op("Abs", g.op("Sub", code, g.floats([np.arange(N_PHASES)])))
    return g.op("Relu", g.op("Sub", g.floats([[1.0]]), away))


def _raw_features(g: Graph, model: Compensator, sample: _Sample) -> str:
    """Virtual signals and commands used as features, in their units, shape (B, F)."""
    both = g.op("Concat", sample.virtual, sample.command, axis=1)
    n = len(CHANNELS)
    places = [*FEATURE_CHANNELS, *range(n, n + model.info.n_commands)]
    return g.op("Gather", both, g.integers(*places), axis=1)


def _features(g: Graph, model: Compensator, raw: str) -> str:
    """Standardised features within their limits, shape (B, F)."""
    centred = g.op("Sub", raw, g.floats(_row(model.feature_mean)))
    features = g.op("Div", centred, g.floats(_row(model.feature_scale)))
    features = g.op("Max", features, g.floats(_row(model.least)))
    return g.op("Min", features, g.floats(_row(model.most)))


def _tables(g: Graph, model: Compensator, here: str) -> list[str]:
    """Mean, scale, mean reading and expected spread of the phase, shape (B, 15) each."""
    mean, scale, reading = (numbers(t) for t in (model.mean, model.scale, model.reading))
    expected = np.abs(scale) * numbers(model.spread_factor)
    row = g.op("MatMul", here, g.floats(np.hstack([mean, scale, reading, expected])))
    return g.split(row, [len(CHANNELS)] * 4, axis=1)


def _remembered(
    g: Graph, sample: _Sample, past: str, mean: str, scale: str, shape: tuple[int, int]
) -> str:
    """Standardised residuals with the present one first, newest first, shape (B, rows 15).

    Args:
        shape: Rows of the past, and number of channels.
    """
    rows, n = shape
    residual = g.op("Sub", g.op("Sub", sample.measured, sample.virtual), mean)
    new = g.op("Div", residual, scale)
    fresh = g.op("Greater", sample.valid, g.floats([[0.5]]))
    held = g.op("Where", fresh, new, past if rows == 1 else g.columns(past, 0, n))
    return held if rows == 1 else g.concat(held, g.columns(past, 0, (rows - 1) * n), axis=1)


def _bounded(g: Graph, model: Compensator, said: str, today: str) -> str:
    """Limited prediction, as `learning.model.linear.bounded`, shape (B, 15); `today` "" for no
    offset."""
    most = BEYOND * _row(model.largest)
    about = g.op("Sub", said, today) if today else said
    about = g.op("Min", g.op("Max", about, g.floats(-most)), g.floats(most))
    return g.op("Add", today, about) if today else about


def _read_then(
    g: Graph, model: Compensator, sample: _Sample, readings: str, begun: str
) -> tuple[str, str, str]:
    """The twin's reading at the newest known residual, shape (B, 15); next state of the
    readings."""
    n, last, time = len(CHANNELS), model.readings - 1, g.integers(1)
    started = g.reshape(g.op("Greater", begun, g.floats([[0.5]])), 0, 1, 1)
    virtual = g.reshape(sample.virtual, 0, 1, n)
    rows = g.op("Where", started, g.reshape(readings, 0, -1, n), virtual)  # (B, readings, 15)
    newest = g.op("Slice", rows, g.integers(0), g.integers(1), time)
    fresh = g.reshape(g.op("Greater", sample.valid, g.floats([[0.5]])), 0, 1, n)
    newest = g.op("Where", fresh, virtual, newest)
    rows = g.concat(newest, g.op("Slice", rows, g.integers(0), g.integers(last), time), axis=1)
    then = g.reshape(g.op("Slice", rows, g.integers(last), g.integers(last + 1), time), 0, n)
    return then, g.reshape(rows, 0, -1), g.op("Max", begun, g.floats([[1.0]]))


def _offset(
    g: Graph, model: Compensator, known: str, read: str, mean_so_far: str
) -> tuple[str, str]:
    """Running means of known residual and reading, shape (B, 2, 15); next state of sums and
    weights."""
    n, (decay, prior) = len(CHANNELS), running_mean(model.info.rate_hz)
    there = g.op("Cast", g.op("Greater", g.op("Abs", known), g.floats([[0.0]])), to=_FLOAT)
    new = g.concat(known, g.op("Mul", read, there), there, axis=1)
    mean_so_far = g.op("Add", g.op("Mul", mean_so_far, g.floats([[decay]])), new)
    sums, weights = g.split(mean_so_far, [2 * n, n], axis=1)
    weights = g.op("Add", weights, g.floats([[prior]]))
    means = g.op("Div", g.reshape(sums, 0, 2, n), g.reshape(weights, 0, 1, n))
    return means, mean_so_far


def _beyond(
    g: Graph, model: Compensator, said: str, distance: str, mean_so_far: str
) -> tuple[str, str]:
    """Linear predictions, for the sensors of `OF_THE_DAY` minus their running means, shape (B, 15),
    which equals the prediction from inputs minus their means; next state of sums and weight."""
    n, (decay, _) = len(CHANNELS), running_mean(model.info.rate_hz)
    counts = g.op("Cast", g.op("LessOrEqual", distance, g.floats([[1.0]])), to=_FLOAT)
    new = g.concat(g.op("Mul", said, counts), counts, axis=1)
    mean_so_far = g.op("Add", g.op("Mul", mean_so_far, g.floats([[decay]])), new)
    sums, weight = g.split(mean_so_far, [n, 1], axis=1)
    away = g.op("Sub", g.op("Mul", said, weight), sums)
    away = g.op("Div", away, g.op("Max", weight, g.floats([[1.0]])))
    of_the_day = g.floats([OF_THE_DAY.astype(np.float64)])
    others = g.op("Mul", said, g.op("Sub", g.floats([[1.0]]), of_the_day))
    return g.op("Add", others, g.op("Mul", away, of_the_day)), mean_so_far


def _innovation_size(g: Graph, sample: _Sample, correction: str, spread: str) -> str:
    """Innovation over its spread, as `innovation_size` of the compensator, shape (B, 15)."""
    residual = g.op("Sub", sample.measured, sample.virtual)
    new = g.op("Abs", g.op("Sub", residual, correction))
    return g.op("Div", new, g.op("Max", spread, g.floats([[NO_SPREAD]])))


def _error_of_today(
    g: Graph, model: Compensator, new: str, sizes: str, errors: str
) -> tuple[str, str, str]:
    """Size of the current flight's errors over the spread, shape (B, 15); states, as of
    `state_sizes`.

    Args:
        new: Size of the present innovations, 0 where there is none, shape (B, 15).
    """
    n, horizon = len(CHANNELS), model.info.horizon
    known = g.columns(sizes, (horizon - 1) * n, horizon * n)
    there = g.op("Cast", g.op("Greater", known, g.floats([[0.0]])), to=_FLOAT)
    known = g.op("Div", known, g.floats([[MEAN_SIZE]]))
    decay = g.floats([[error_memory(model.info.rate_hz)]])
    errors = g.op("Add", g.op("Mul", errors, decay), g.concat(known, there, axis=1))
    sums, weights = g.split(g.op("Add", errors, g.floats([[1.0]])), [n, n], axis=1)
    earlier = "" if horizon == 1 else g.columns(sizes, 0, (horizon - 1) * n)
    return g.op("Div", sums, weights), g.concat(new, earlier, axis=1), errors


def _smoothed(g: Graph, model: Compensator, features: str, slow: str) -> str:
    """Low-passed features, shape (B, 2 F)."""
    shares = np.repeat(smoothing(model.info.rate_hz), len(model.features))[None]
    away = g.op("Sub", g.concat(features, features, axis=1), slow)
    return g.op("Add", slow, g.op("Mul", g.floats(shares), away))


def _distance(g: Graph, model: Compensator, raw: str) -> str:
    """Distance from the training data, shape (B, 1)."""
    parts = []
    for some in PLACES:
        own = g.op("Gather", raw, g.integers(*some), axis=1)
        if len(some) > 1:
            square = g.op("ReduceSum", g.op("Mul", own, own), g.integers(1), keepdims=1)
            own = g.op("Sqrt", square)
        parts.append(own)
    first = len(FEATURE_CHANNELS)
    drives = g.columns(raw, first, first + model.info.n_commands)
    centred = g.op("Sub", g.concat(*parts, drives, axis=1), g.floats(_row(model.place_centre)))
    whitening = numbers(model.place_whitening) / numbers(model.place_scale)
    spread = numbers(model.place_reach) * np.sqrt(len(whitening))
    white = g.op("MatMul", centred, g.floats((whitening / spread).T))
    return g.op("Sqrt", g.op("ReduceSum", g.op("Mul", white, white), g.integers(1), keepdims=1))


def _fade(g: Graph, distance: str, begin: float, end: float) -> str:
    """Fade-out, as in `learning.data.envelope`, shape (B, 1)."""
    away = g.op("Div", g.op("Sub", distance, g.floats([[begin]])), g.floats([[end - begin]]))
    t = g.op("Min", g.op("Max", away, g.floats([[0.0]])), g.floats([[1.0]]))
    rest = g.op("Sub", g.floats([[3.0]]), g.op("Add", t, t))
    return g.op("Sub", g.floats([[1.0]]), g.op("Mul", g.op("Mul", t, t), rest))


def _row(values: Tensor) -> Array:
    return numbers(values)[None]


def network(
    g: Graph, model: Compensator, known: str, features: str, here: str, cells: str
) -> tuple[str, str, str]:
    """Output times its gain (B, 15), its log spread (B, 15), "" without a spread head, and next
    cell states."""
    network, preset = _network(model), model.info.preset
    clusters = [n for n in network.networks if isinstance(n, ClusterNetwork)]
    units = [*preset.encoder_units, *preset.decoder_units]
    with g.scope("cells"):
        rows = g.transpose(g.reshape(cells, 0, len(clusters), -1), 1, 0, 2)  # (C, B, numbers)
        parts = g.split(rows, [u for u in units for _ in range(2)], axis=2)
    states = list(zip(parts[::2], parts[1::2], strict=True))
    n_encoder = len(preset.encoder_units)

    kinds = [(known, network.sees_known), (features, network.sees_features), (here, True)]
    with g.scope("encoder"):
        seen = g.concat(*(name if used else "" for name, used in kinds), axis=1)
        tables = np.stack([_seen_table(model, i) for i in range(len(clusters))])
        first = g.op("MatMul", seen, g.floats(tables))
        gates, through = g.split(first, [4 * units[0], preset.code_size], axis=2)
        encoders = [c.encoder for c in clusters]
        h, encoded = _lstm(g, encoders, gates, "", 0, states[:n_encoder])
        to_latent = np.stack([numbers(c.to_latent.weight).T * _closeness(c) for c in clusters])
        with g.scope("to_latent"):
            z = g.op("Add", g.op("MatMul", h, g.floats(to_latent)), through)
    with g.scope("quantiser"):
        code = _quantised(g, model, clusters, z)
    with g.scope("decoder"):
        embedding = numbers(network.phase_embedding)
        biases = np.stack([_phase_table(c.decoder, embedding) for c in clusters])
        gates = g.op("MatMul", here, g.floats(biases))
        decoders = [c.decoder for c in clusters]
        h, decoded = _lstm(g, decoders, gates, code, preset.code_size, states[n_encoder:])
    with g.scope("read_out"):
        y, log_spread = _read_out(g, model, clusters, h, code)
    with g.scope("cells"):
        after = g.concat(*(v for pair in (*encoded, *decoded) for v in pair), axis=2)
        return y, log_spread, _side_by_side(g, after)


def _network(model: Compensator) -> SvqNetwork:
    """The network of a model that has one."""
    assert model.network is not None
    return model.network


def _side_by_side(g: Graph, of_clusters: str) -> str:
    """Outputs of the clusters in one row per sample: (C, B, n) to (B, C n)."""
    return g.reshape(g.transpose(of_clusters, 1, 0, 2), 0, -1)


def _closeness(cluster: ClusterNetwork) -> float:
    """Scale of the graph's latent relative to the network's: its product with a code is a logit."""
    return 2 / cluster.quantiser.temperature


def _seen_table(model: Compensator, number: int) -> Array:
    """Weights from [known residuals, features, phase] to a cluster's gates and latent, (S, 4 U +
    D)."""
    network = _network(model)
    cluster = network.networks[number]
    assert isinstance(cluster, ClusterNetwork)
    n_known = len(CHANNELS) if network.sees_known else 0
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


def _lstm(
    g: Graph,
    stacks: Sequence[LstmStack],
    gates: str,
    x: str,
    width: int,
    states: Sequence[tuple[str, str]],
) -> tuple[str, list[tuple[str, str]]]:
    """LSTM layers; returns output and next states, shapes (C, B, U).

    Args:
        g: Graph to which they are added.
        stacks: LSTM layers of each cluster.
        gates: Gates of the first layer without the contributions of `x` and the state, (C, B, 4 U).
        x: Further input of the first layer, shape (C, B, width); "" for none.
        width: Width of `x`.
        states: Names of output and cell state of each layer.
    """
    after: list[tuple[str, str]] = []
    for number, (h, c) in enumerate(states):
        layers = [_layer(stack, number) for stack in stacks]
        units = layers[0].hidden_size
        weights = [np.vstack([_of_input(k)[:width], _of_state(k)]) for k in layers]
        with g.scope(f"layer_{number}"):
            sums = g.op("MatMul", g.concat(x, h, axis=2), g.floats(np.stack(weights)))
            if number:
                gates = g.floats(np.stack([_bias(k)[None] for k in layers]))
            ifo, new = g.split(g.op("Add", sums, gates), [3 * units, units], axis=2)
            i, f, o = g.split(g.op("Sigmoid", ifo), [units] * 3, axis=2)
            c = g.op("Add", g.op("Mul", f, c), g.op("Mul", i, g.op("Tanh", new)))
            x, width = g.op("Mul", o, g.op("Tanh", c)), units
        after.append((x, c))
    return x, after


def _quantised(g: Graph, model: Compensator, clusters: Sequence[ClusterNetwork], z: str) -> str:
    """Code of a latent, shape (C, B, D)."""
    kind, temperature = model.info.preset.quantiser, model.info.preset.temperature
    if kind == "none":
        return g.op("Mul", z, g.floats(temperature / 2))
    codes = np.stack([numbers(c.quantiser.codes) for c in clusters])  # (C, K, D)
    book = g.floats(codes)  # one constant for both products, stored once
    logits = g.transpose(g.op("MatMul", book, g.transpose(z, 0, 2, 1)), 0, 2, 1)  # (C, B, K)
    logits = g.op("Sub", logits, g.floats((codes**2).sum(-1)[:, None] / temperature))
    if kind == "soft":
        shares = g.op("Softmax", logits, axis=2)
    else:
        largest = g.op("ReduceMax", logits, axes=[2], keepdims=1)
        nearest = g.op("Cast", g.op("Equal", logits, largest), to=_FLOAT)
        shares = g.op("Div", nearest, g.op("ReduceSum", nearest, g.integers(2), keepdims=1))
    return g.op("MatMul", shares, book)


def _read_out(
    g: Graph, model: Compensator, clusters: Sequence[ClusterNetwork], h: str, code: str
) -> tuple[str, str]:
    """Output times its gain and its log spread ("" without a spread head), shape (B, 15) each.

    One product over all clusters' outputs, with zero weights for the channels of others.
    """
    preset, gain = model.info.preset, numbers(model.gate * model.leftover)
    n, units, n_channels = len(clusters), preset.decoder_units[-1], len(CHANNELS)
    width = units + (preset.code_size if preset.skip else 0)
    weights = np.zeros((n, width, 2, n_channels))
    biases = np.zeros((2, n_channels))
    for i, (cluster, own) in enumerate(zip(clusters, _network(model).clusters, strict=True)):
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
    seen = _side_by_side(g, g.concat(h, code, axis=2) if preset.skip else h)
    flat = g.floats(weights[:, :, :given].reshape(n * width, given * n_channels))
    row = g.op("Add", g.op("MatMul", seen, flat), g.floats(biases[:given].reshape(1, -1)))
    y, log_spread = g.split(row, [n_channels, n_channels * (given - 1)], axis=1)
    if log_spread:
        limits = g.floats(-LOG_SPREAD_LIMIT), g.floats(LOG_SPREAD_LIMIT)
        log_spread = g.op("Clip", log_spread, *limits)
    return y, log_spread


# -- weights --------------------------------------------------------------------------------


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
