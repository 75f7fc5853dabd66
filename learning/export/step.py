"""`Compensator.step` as an ONNX model: a sample per call, all memory in `state`, all of it inside.

    virtual (B, 15), command (B, m), phase (B, 1), measured (B, 15), valid (B, 15), state (B, N)
    -> correction (B, 15), spread (B, 15), anomaly (B, 1), inside (B, 1), state_out (B, N)

The first axis, "batch", is dynamic: B aircraft side by side, each with a state of its own.

Few and wide operators, since most of the time of a small network goes into their calls.
"""

from dataclasses import dataclass

import numpy as np
import onnx
import torch
from numpy.typing import NDArray
from torch import Tensor

from twin.physics.residual_force import LINEAR_BEGIN, LINEAR_END

from ..data.channels import CHANNELS, N_PHASES, PLACES, SEEN
from ..data.envelope import BEYOND, NETWORK_END
from ..data.sequences import LAGS, SMOOTHING_S, limited, running_mean, smoothing
from ..model.compensator import NO_SPREAD, Compensator
from .graph import Graph
from .network import network, numbers

Array = NDArray[np.float64]

INPUTS = ("virtual", "command", "phase", "measured", "valid", "state")
OUTPUTS = ("correction", "spread", "anomaly", "inside", "state_out")
_FLOAT = onnx.TensorProto.FLOAT


def streaming_model(compensator: Compensator, batch: int | None = None) -> onnx.ModelProto:
    """The checked model, without metadata; the same bytes for the same weights.

    Args:
        compensator: Trained.
        batch: Samples of a call; None: any number.
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
    """Names of what came in, zero throughout where a number is none.

    Attributes:
        whole: Whether every number is one, Boolean of shape (B, 1).
        measured: "" where nothing measured is looked at, as `valid`.
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
    none = g.op("IsNaN", g.op("Sub", given, given))  # of an infinite number, too
    lost = g.op("ReduceMax", g.op("Cast", none, to=_FLOAT), axes=[1], keepdims=1)
    whole = g.op("Less", lost, g.floats([[0.5]]))
    parts = g.split(g.op("Where", whole, given, g.floats([np.zeros(sum(widths))])), widths, axis=1)
    return _Sample(whole, *parts)


def _step(g: Graph, model: Compensator) -> None:
    """`Compensator.step` as operators."""
    rows, protocol, n = model.history, model.info.protocol, len(CHANNELS)
    parts = g.split("state", list(model.state_sizes), axis=1)
    past, mean_so_far, readings, begun, strange, slow, cells = parts
    with g.scope("inputs"):
        sample = _sample(g, model)
        here = _one_hot(g, sample)
        mean, scale, reading, expected = _tables(g, model, here)
    looks = protocol != "reconstruct"  # which looks at no feature
    with g.scope("features"):
        raw = _raw_features(g, model, sample) if looks else ""
        features = _features(g, model, raw) if looks else ""
        if rows:
            past = _remembered(g, sample, past, mean, scale, (rows, n))
        if looks:  # elsewhere nothing looks at them, and their state stays as it is
            slow = _smoothed(g, model, features, slow)
        first = model.info.horizon * n
        known = past if rows <= 1 else g.columns(past, first, first + n)
    y, log_spread, alarm, cells = network(g, model, known, features, here, cells)

    said, today, base = "", "", numbers(model.base)
    with g.scope("linear"):
        if looks:
            inputs = g.op("Concat", features, slow, axis=1)
            of_inputs = base[:, -len(model.features) * (1 + len(SMOOTHING_S)) :]
            said = g.op("MatMul", inputs, g.floats(of_inputs.T))
            own = g.op("Div", g.op("Sub", sample.virtual, reading), scale)
        if protocol == "free":
            said = g.op("Add", said, g.op("Mul", own, g.floats(base[:, :1].T)))
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
        more = g.op("Mul", scale, y)
        if log_spread:
            expected = g.op("Mul", expected, g.op("Exp", log_spread))
        inside, rms = sample.whole, g.floats(_row(model.rms))
        if limited(protocol):
            distance = _distance(g, model, raw)
            close = _fade(g, distance, 1.0, NETWORK_END)
            linear = g.op("Mul", linear, _fade(g, distance, LINEAR_BEGIN, LINEAR_END))
            more = g.op("Mul", more, close)
            expected = g.op("Add", rms, g.op("Mul", close, g.op("Sub", expected, rms)))
            within = g.op("LessOrEqual", distance, g.floats([[1.0]]))
            inside = g.op("And", sample.whole, within)
        correction, nothing = g.op("Add", linear, more), g.floats(np.zeros((1, n)))
    g.output("correction", n, "Where", sample.whole, correction, nothing)
    g.output("spread", n, "Where", sample.whole, expected, rms)
    with g.scope("alarm"):
        if protocol == "track":
            strange = _strangeness(g, model, sample, correction, expected, strange)
            alarm = g.op("ReduceMax", strange, axes=[1], keepdims=1)
        else:
            alarm = g.op("ReduceMax", alarm, axes=[0], keepdims=0)
    g.output("anomaly", 1, "Where", sample.whole, alarm, g.floats([[0.0]]))
    g.output("inside", 1, "Cast", inside, to=_FLOAT)
    later = g.concat(past, mean_so_far, readings, begun, strange, slow, cells, axis=1)
    g.output("state_out", model.state_size, "Where", sample.whole, later, "state")


def _one_hot(g: Graph, sample: _Sample) -> str:
    """1 at the phase's code, shape (B, phases)."""
    code = g.op("Clip", sample.phase, g.floats(0.0), g.floats(N_PHASES - 1))
    away = g.op("Abs", g.op("Sub", code, g.floats([np.arange(N_PHASES)])))
    return g.op("Relu", g.op("Sub", g.floats([[1.0]]), away))


def _raw_features(g: Graph, model: Compensator, sample: _Sample) -> str:
    """Virtual signals and commands that are features, in their units, shape (B, F)."""
    both = g.op("Concat", sample.virtual, sample.command, axis=1)
    n = len(CHANNELS)
    places = [*SEEN, *range(n, n + model.info.n_commands)]
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
    """Standardised residuals, newest first, with the present one in front; (B, rows 15).

    Args:
        shape: Rows of the past, and channels.
    """
    rows, n = shape
    residual = g.op("Sub", g.op("Sub", sample.measured, sample.virtual), mean)
    new = g.op("Div", residual, scale)
    fresh = g.op("Greater", sample.valid, g.floats([[0.5]]))
    held = g.op("Where", fresh, new, past if rows == 1 else g.columns(past, 0, n))
    return held if rows == 1 else g.concat(held, g.columns(past, 0, (rows - 1) * n), axis=1)


def _bounded(g: Graph, model: Compensator, said: str, today: str) -> str:
    """As `learning.model.linear_predictor.bounded`, shape (B, 15); `today` "" for no offset."""
    most = BEYOND * _row(model.largest)
    about = g.op("Sub", said, today) if today else said
    about = g.op("Min", g.op("Max", about, g.floats(-most)), g.floats(most))
    return g.op("Add", today, about) if today else about


def _read_then(
    g: Graph, model: Compensator, sample: _Sample, readings: str, begun: str
) -> tuple[str, str, str]:
    """What the twin read at the newest known residual (B, 15); next state of the readings."""
    n, last, time = len(CHANNELS), model.readings - 1, g.integers(1)
    kept = g.reshape(g.op("Greater", begun, g.floats([[0.5]])), 0, 1, 1)
    virtual = g.reshape(sample.virtual, 0, 1, n)
    rows = g.op("Where", kept, g.reshape(readings, 0, -1, n), virtual)  # (B, readings, 15)
    newest = g.op("Slice", rows, g.integers(0), g.integers(1), time)
    fresh = g.reshape(g.op("Greater", sample.valid, g.floats([[0.5]])), 0, 1, n)
    newest = g.op("Where", fresh, virtual, newest)
    rows = g.concat(newest, g.op("Slice", rows, g.integers(0), g.integers(last), time), axis=1)
    then = g.reshape(g.op("Slice", rows, g.integers(last), g.integers(last + 1), time), 0, n)
    return then, g.reshape(rows, 0, -1), g.op("Max", begun, g.floats([[1.0]]))


def _offset(
    g: Graph, model: Compensator, known: str, read: str, mean_so_far: str
) -> tuple[str, str]:
    """Running means of known residual and reading (B, 2, 15); next state of sums and weights."""
    n, (kept, prior) = len(CHANNELS), running_mean(model.info.rate_hz)
    there = g.op("Cast", g.op("Greater", g.op("Abs", known), g.floats([[0.0]])), to=_FLOAT)
    new = g.concat(known, g.op("Mul", read, there), there, axis=1)
    mean_so_far = g.op("Add", g.op("Mul", mean_so_far, g.floats([[kept]])), new)
    sums, weights = g.split(mean_so_far, [2 * n, n], axis=1)
    weights = g.op("Add", weights, g.floats([[prior]]))
    means = g.op("Div", g.reshape(sums, 0, 2, n), g.reshape(weights, 0, 1, n))
    return means, mean_so_far


def _strangeness(
    g: Graph, model: Compensator, sample: _Sample, correction: str, spread: str, before: str
) -> str:
    """Of the newest reading of each channel, shape (B, 15)."""
    residual = g.op("Sub", sample.measured, sample.virtual)
    new = g.op("Abs", g.op("Sub", residual, correction))
    level = g.floats(_row(model.anomaly_scale))
    usual = g.op("Mul", g.op("Max", spread, g.floats([[NO_SPREAD]])), level)
    fresh = g.op("Greater", sample.valid, g.floats([[0.5]]))
    return g.op("Where", fresh, g.op("Div", new, usual), before)


def _smoothed(g: Graph, model: Compensator, features: str, slow: str) -> str:
    """Low-passed features, shape (B, 2 F)."""
    shares = np.repeat(smoothing(model.info.rate_hz), len(model.features))[None]
    away = g.op("Sub", g.concat(features, features, axis=1), slow)
    return g.op("Add", slow, g.op("Mul", g.floats(shares), away))


def _distance(g: Graph, model: Compensator, raw: str) -> str:
    """From where training has been, shape (B, 1)."""
    parts = []
    for some in PLACES:
        own = g.op("Gather", raw, g.integers(*some), axis=1)
        if len(some) > 1:
            square = g.op("ReduceSum", g.op("Mul", own, own), g.integers(1), keepdims=1)
            own = g.op("Sqrt", square)
        parts.append(own)
    first = len(SEEN)
    drives = g.columns(raw, first, first + model.info.n_commands)
    centred = g.op("Sub", g.concat(*parts, drives, axis=1), g.floats(_row(model.place_centre)))
    whitening = numbers(model.place_whitening) / numbers(model.place_scale)
    spread = numbers(model.place_reach) * np.sqrt(len(whitening))
    white = g.op("MatMul", centred, g.floats((whitening / spread).T))
    return g.op("Sqrt", g.op("ReduceSum", g.op("Mul", white, white), g.integers(1), keepdims=1))


def _fade(g: Graph, distance: str, begin: float, end: float) -> str:
    """As in `learning.data.envelope`, shape (B, 1)."""
    away = g.op("Div", g.op("Sub", distance, g.floats([[begin]])), g.floats([[end - begin]]))
    t = g.op("Min", g.op("Max", away, g.floats([[0.0]])), g.floats([[1.0]]))
    rest = g.op("Sub", g.floats([[3.0]]), g.op("Add", t, t))
    return g.op("Sub", g.floats([[1.0]]), g.op("Mul", g.op("Mul", t, t), rest))


def _row(values: Tensor) -> Array:
    return numbers(values)[None]
