"""How the outputs of a slave answer to small changes of its inputs."""

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from .slave import Slave

Array = NDArray[np.float64]
_ROOT_EPS = float(np.sqrt(np.finfo(np.float64).eps))


def jacobian(slave: Slave, outputs: Sequence[str], inputs: Sequence[str]) -> Callable[[], Array]:
    """Derivatives of bound outputs against bound inputs, at the present inputs.

    The FMU's directional derivatives, or forward differences by set and get where it has none.
    What is no real number does not answer.

    Returns:
        A function without arguments that gives the matrix, shape (outputs, inputs).
    """
    rows = [i for i, n in enumerate(outputs) if slave.ports[n].kind == "Real"]
    columns = [i for i, n in enumerate(inputs) if slave.ports[n].kind == "Real"]
    made = _tangents if slave.interface.has_derivatives else _differences
    inner = made(slave, [outputs[i] for i in rows], [inputs[i] for i in columns])
    matrix = np.zeros((len(outputs), len(inputs)))
    at = np.ix_(rows, columns)

    def evaluate() -> Array:
        """Fill the matrix."""
        matrix[at] = inner()
        return matrix

    return evaluate


def _tangents(slave: Slave, outputs: Sequence[str], inputs: Sequence[str]) -> Callable[[], Array]:
    columns = np.zeros((len(inputs), len(outputs)))
    ports = [slave.ports[n] for n in outputs]
    calls = [
        slave.library.tangent(ports, slave.ports[name], column)
        for name, column in zip(inputs, columns, strict=True)
    ]

    def evaluate() -> Array:
        """One call per input."""
        for call in calls:
            if status := call():
                slave.judge(status, "directional derivative")
        return columns.T

    return evaluate


def _differences(
    slave: Slave, outputs: Sequence[str], inputs: Sequence[str]
) -> Callable[[], Array]:
    rows = [slave.bound_outputs.index(n) for n in outputs]
    columns = [slave.bound_inputs.index(n) for n in inputs]
    nominal = [slave.ports[n].nominal for n in inputs]

    def evaluate() -> Array:
        """One set and get per input; all is as before afterwards."""
        u, y = slave.inputs.copy(), slave.outputs.copy()
        matrix = np.zeros((len(rows), len(columns)))
        for k, j in enumerate(columns):
            slave.inputs[j] = u[j] + _ROOT_EPS * max(abs(u[j]), nominal[k])
            slave.write_inputs()
            slave.read_outputs()
            matrix[:, k] = (slave.outputs[rows] - y[rows]) / (slave.inputs[j] - u[j])
            slave.inputs[j] = u[j]
        slave.write_inputs()
        slave.outputs[:] = y
        return matrix

    return evaluate
