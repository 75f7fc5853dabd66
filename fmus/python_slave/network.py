"""Compensator of a Python slave: its ONNX file run by onnxruntime, behind `script`.

`build` copies this file into the FMU, next to `script`. Values equal those of `c/compensator.h`
except for rounding of float32 sums.
"""

import json
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import onnxruntime
from numpy.typing import NDArray

from twin.component import Run, State, Variable

from .script import ComponentSlave

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Network:
    """A compensator with the interface of a component, as far as slaves and runs use it."""

    name: str
    variables: tuple[Variable, ...]
    states: tuple[State, ...]
    state_size: int
    n_commands: int
    sensors: tuple[int, ...] | None
    uncorrected_rms: tuple[float, ...]
    session: Any
    may_lack: frozenset[str]

    sampling = SimpleNamespace(period="sample_period", lines=())

    @property
    def parameters(self) -> tuple[Variable, ...]:
        """Parameters of a component."""
        return self._of("parameter")

    @property
    def inputs(self) -> tuple[Variable, ...]:
        """Inputs of a component."""
        return self._of("input")

    @property
    def output_variables(self) -> tuple[Variable, ...]:
        """Outputs of a component."""
        return self._of("output")

    def advance(self, x: Array, u: Array, p: Array, duration_s: float) -> Array:
        """State after a step: unchanged between sample instants."""
        return x

    def start(self) -> Array:
        """State before the first sample."""
        n = len(self.uncorrected_rms)
        x = np.zeros(len(self.states))
        x[self.state_size + n : self.state_size + 2 * n] = self.uncorrected_rms
        return x

    def sampled(self, x: Array, u: Array) -> Array:
        """State after a sample: the network's own, its outputs, and the number of dropped
        samples."""
        n, m = len(self.uncorrected_rms), self.n_commands
        measured = valid = np.zeros(n)
        if self.sensors is not None:
            measured, valid = u[n + m + 1 :][:n], u[2 * n + m + 1 :][list(self.sensors)]
            measured = np.where(valid > 0.5, measured, 0.0)
        if np.isnan([*u[: n + m + 1], *measured]).any():
            return np.concatenate(
                [x[: self.state_size], self.start()[self.state_size : -1], [x[-1] + 1]]
            )
        rows = (u[:n], u[n : n + m], u[n + m : n + m + 1], measured, valid, x[: self.state_size])
        names = ("virtual", "command", "phase", "measured", "valid", "state")
        fed = {k: v[None].astype(np.float32) for k, v in zip(names, rows, strict=True)}
        *said, state = self.session.run(None, fed)
        return np.concatenate([state[0], *(s[0] for s in said), x[-1:]]).astype(np.float64)

    def outputs(self, x: Array, u: Array) -> Array:
        """Held correction, corrected inputs, spread, anomaly, inside, number of dropped samples."""
        n = len(self.uncorrected_rms)
        correction, rest = x[self.state_size :][:n], x[self.state_size + n :]
        return np.concatenate([correction, u[:n] + correction, rest])

    def _of(self, causality: str) -> tuple[Variable, ...]:
        return tuple(v for v in self.variables if v.causality == causality)


class NetworkRun(Run):
    """One simulation; the first sample is one period after the start."""

    component: Any

    def __init__(self, component: Any, u: Array, p: Array, time_s: float = 0.0) -> None:
        self.component, self.p = component, p
        self.x = component.start()
        self._start_s, self._count, self._records = time_s, 0, ()

    def outputs(self, u: Array) -> Array:
        """Present outputs, shape (n_y,)."""
        return np.asarray(self.component.outputs(self.x, u), dtype=np.float64)

    def _sample(self, u: Array) -> None:
        self.x = self.component.sampled(self.x, u)


class NetworkSlave(ComponentSlave):
    """One instance of the FMU."""

    run_type = NetworkRun

    @property
    def may_lack(self) -> frozenset[str]:
        """Variables of the network that may be NaN."""
        return _network().may_lack

    @staticmethod
    def described() -> Any:
        """Network of this FMU."""
        return _network()


@cache
def _network() -> Network:
    """Network, read once, for the first instance: later the folder of this file may be deleted."""
    fields = json.loads(Path(__file__).with_name("network.json").read_text())
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    return Network(
        name=fields["name"],
        variables=tuple(Variable.from_row(row) for row in fields["variables"]),
        states=tuple(State(name, "1", "") for name in fields["states"]),
        state_size=fields["state_size"],
        n_commands=fields["n_commands"],
        sensors=None if fields["sensors"] is None else tuple(fields["sensors"]),
        uncorrected_rms=tuple(fields["uncorrected_rms"]),
        may_lack=frozenset(fields["may_lack"]),
        session=onnxruntime.InferenceSession(
            Path(__file__).with_name("model.onnx").read_bytes(),
            options,
            providers=["CPUExecutionProvider"],
        ),
    )
