"""The network of a compensator as ONNX operators: all clusters as one batch of products.

Each cluster sees every channel, with weights of zero for those of others; what only the phase
decides (its embedding, every bias) is one table; what the output is multiplied by is part of the
last weights. LSTM cells are written out, which any runtime, the C generator and the quantiser to
int8 understand.
"""

from collections.abc import Sequence

import numpy as np
import onnx
from numpy.typing import NDArray
from torch import Tensor, nn

from ..data.channels import CHANNELS, N_PHASES
from ..model.compensator import Compensator
from ..model.network import LOG_SPREAD_LIMIT, ClusterNetwork, LstmStack
from .graph import Graph

Array = NDArray[np.float64]


def network(
    g: Graph, model: Compensator, known: str, features: str, here: str, cells: str
) -> tuple[str, str, str, str]:
    """Output times its gain, its log spread, alarm of each cluster, next cells.

    Returns:
        Shapes (B, 15), (B, 15), (clusters, B, 1), (B, numbers) for B samples; "" for the log spread
        without a head, and for the alarm in `track`, which knows innovations.
    """
    network, preset = model.network, model.info.preset
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
        code, alarm = _quantised(g, model, clusters, z)
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
        return y, log_spread, alarm, _side_by_side(g, after)


def _side_by_side(g: Graph, of_clusters: str) -> str:
    """Numbers of the clusters in one row per sample: (C, B, n) to (B, C n)."""
    return g.reshape(g.transpose(of_clusters, 1, 0, 2), 0, -1)


def _closeness(cluster: ClusterNetwork) -> float:
    """The latent of the graph over that of the network: its product with a code is a logit."""
    return 2 / cluster.quantiser.temperature


def _seen_table(model: Compensator, number: int) -> Array:
    """From [known residuals, features, phase] to a cluster's gates and latent, (S, 4 U + D)."""
    network = model.network
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
    """What the phase adds to the gates of the first layer, biases included; (phases, 4 U)."""
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
    """LSTM layers; output and next states, shapes (C, B, U).

    Args:
        g: The graph.
        stacks: Of each cluster.
        gates: Of the first layer, but for what `x` and the state add; (C, B, 4 U).
        x: Input of the first layer that is not in `gates`, shape (C, B, width); "" for none.
        width: Of `x`.
        states: Output and cell of each layer.
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


def _quantised(
    g: Graph, model: Compensator, clusters: Sequence[ClusterNetwork], z: str
) -> tuple[str, str]:
    """Code (C, B, D) and alarm (C, B, 1): |z - e|^2 of the nearest code over what is usual; "" for
    the alarm in `track`."""
    kind, temperature = model.info.preset.quantiser, model.info.preset.temperature
    alarmed = model.info.protocol != "track"  # which knows innovations
    if kind == "none":
        code = g.op("Mul", z, g.floats(temperature / 2))
        return code, _far(g, model, z) if alarmed else ""
    codes = np.stack([numbers(c.quantiser.codes) for c in clusters])  # (C, K, D)
    book = g.floats(codes)  # one constant for both products: its numbers are read once
    logits = g.transpose(g.op("MatMul", book, g.transpose(z, 0, 2, 1)), 0, 2, 1)  # (C, B, K)
    logits = g.op("Sub", logits, g.floats((codes**2).sum(-1)[:, None] / temperature))
    largest = ""
    if alarmed or kind == "hard":
        largest = g.op("ReduceMax", logits, axes=[2], keepdims=1)
    if kind == "soft":
        shares = g.op("Softmax", logits, axis=2)
    else:
        nearest = g.op("Cast", g.op("Equal", logits, largest), to=onnx.TensorProto.FLOAT)
        shares = g.op("Div", nearest, g.op("ReduceSum", nearest, g.integers(2), keepdims=1))
    code = g.op("MatMul", shares, book)
    if not alarmed:
        return code, ""
    # |z - e|^2 = |z|^2 - (2 z.e - |e|^2)
    usual = numbers(model.anomaly_scale)[:, None, None]
    nearness = g.op("Mul", largest, g.floats(temperature / usual))
    return code, g.op("Sub", _far(g, model, z), nearness)


def _far(g: Graph, model: Compensator, z: str) -> str:
    """|z|^2 over what is usual, shape (C, B, 1)."""
    usual = numbers(model.anomaly_scale)[:, None, None]
    square = g.op("ReduceSum", g.op("Mul", z, z), g.integers(2), keepdims=1)
    return g.op("Mul", square, g.floats(model.info.preset.temperature**2 / 4 / usual))


def _read_out(
    g: Graph, model: Compensator, clusters: Sequence[ClusterNetwork], h: str, code: str
) -> tuple[str, str]:
    """Output times its gain and its log spread ("" without a head), shape (B, 15) each.

    One product: the clusters' numbers side by side, zero for the channels of others.
    """
    preset, gain = model.info.preset, numbers(model.gate * model.leftover)
    n, units, n_channels = len(clusters), preset.decoder_units[-1], len(CHANNELS)
    width = units + (preset.code_size if preset.skip else 0)
    weights = np.zeros((n, width, 2, n_channels))
    biases = np.zeros((2, n_channels))
    for i, (cluster, own) in enumerate(zip(clusters, model.network.clusters, strict=True)):
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
    """Of a tensor, float64."""
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
    """Shape (4 U,)."""
    return _gates(layer.all_weights[0][2]) + _gates(layer.all_weights[0][3])


def _gates(values: Tensor) -> Array:
    """Gates last and in the order input, forget, output, new: what goes into one sigmoid first."""
    i, f, new, o = np.split(numbers(values), 4)
    return np.concatenate([i, f, o, new]).T
