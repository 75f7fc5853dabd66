"""The exported model with weights of 8 bits: less than half of the size, nearly the same numbers.

Quantised are the products with the weights of the LSTM cells and of the latent, each with one scale
(dynamic: that of the other factor is found per sample). Codebook, linear prediction and read-out
stay as they are, and so do the tables in physical units.
"""

import logging
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import onnx
import onnxruntime
from numpy.typing import NDArray
from onnxruntime.quantization import QuantType, quantize_dynamic

from .step import INPUTS, OUTPUTS

Vectors = Mapping[str, NDArray[np.float32]]


def quantised(model: onnx.ModelProto) -> onnx.ModelProto:
    """The model with smaller weights; without shapes of what is between its operators."""
    given = onnx.ModelProto()
    given.CopyFrom(model)
    with tempfile.TemporaryDirectory(prefix="uavtwin-") as name, _quiet():
        path = Path(name, "model.onnx")
        quantize_dynamic(
            given,
            path,
            op_types_to_quantize=["MatMul"],
            nodes_to_quantize=_wide_products(model),
            weight_type=QuantType.QInt8,
        )
        return onnx.load_model(path)


def deviation(model: onnx.ModelProto, reference: Vectors) -> float:
    """Rms difference of the correction over its rms, median of the channels that have one.

    Args:
        model: As exported.
        reference: Inputs, and the outputs that they should have.
    """
    right = reference["correction"].astype(np.float64)
    wrong = streamed(model, reference)["correction"] - right
    rms = np.sqrt(np.mean(right**2, axis=0))
    used = rms > 0
    return (
        float(np.median(np.sqrt(np.mean(wrong**2, axis=0))[used] / rms[used]))
        if used.any()
        else 0.0
    )


def streamed(model: onnx.ModelProto, inputs: Vectors) -> dict[str, NDArray[np.float32]]:
    """Outputs by onnxruntime on one thread, sample after sample from the state zero.

    Args:
        model: As exported.
        inputs: By name, shape (samples, width) each.

    Returns:
        By name, shape (samples, width) each.
    """
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    session = onnxruntime.InferenceSession(
        model.SerializeToString(), options, providers=["CPUExecutionProvider"]
    )
    (size,) = (i.shape[1] for i in session.get_inputs() if i.name == INPUTS[-1])
    state, rows = np.zeros((1, size), np.float32), []
    for k in range(len(inputs[INPUTS[0]])):
        now = {name: inputs[name][k : k + 1] for name in INPUTS[:-1]}
        *said, state = session.run(None, now | {INPUTS[-1]: state})
        rows.append([s[0] for s in said])
    columns = [np.stack(column) for column in zip(*rows, strict=True)]
    return dict(zip(OUTPUTS[:-1], columns, strict=True))


def _wide_products(model: onnx.ModelProto) -> list[str]:
    """Names of the products with a batch of weights that is used once: not the codebook."""
    batches = {t.name for t in model.graph.initializer if len(t.dims) == 3}
    uses = [name for node in model.graph.node for name in node.input]
    once = {name for name in batches if uses.count(name) == 1}
    return [n.name for n in model.graph.node if n.op_type == "MatMul" and n.input[1] in once]


@contextmanager
def _quiet() -> Iterator[None]:
    """Without the quantiser's advice to prepare the model, which is written out already."""
    before = logging.root.manager.disable
    logging.disable(logging.WARNING)
    try:
        yield
    finally:
        logging.disable(before)
