"""A system that was trained, as a model: windows or whole spans in, residuals out."""

import zlib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from twin.errors import ModelError
from twin.representation import short_repr

from ..data.channels import N_PHASES
from ..data.flights import ResidualFlight
from ..data.scaling import Scaling
from ..data.sequences import SpanSequence, one_hot, sequences
from ..preset import Protocol
from ..systems.system import Numbers, System, SystemPreset
from ..threads import one_thread
from .corrected import Corrected
from .family import no_alarm
from .info import ModelInfo

Array = NDArray[np.float64]
_SCALING, _PRIOR, _NETWORK, _EXPECTED = "scaling.", "prior.", "network.", "expected"


@dataclass(frozen=True, slots=True)
class SystemModel:
    """Weights, scaling, and what its draws come from.

    Attributes:
        info: What it is.
        name: Its row in the registry.
        system: Trained.
        scaling: Of residuals and features.
        prior: Of `System.learn_prior`; empty without one.
        expected: Rms of what it left of its training flights; of its draws the spread that they
            are to have, shape (phases, 15), units of the channels.
        draws: Seed of what it draws; None: it says what it makes of the flight.
    """

    info: ModelInfo[SystemPreset]
    name: str
    system: System
    scaling: Scaling
    prior: Numbers
    expected: Array
    draws: int | None = None

    __repr__ = short_repr

    @property
    def family(self) -> str:
        """Its row in the registry."""
        return self.name

    def with_seed(self, seed: int) -> "SystemModel":
        """The same as a generator: it sees phases and span limits, and nothing that was measured.

        Args:
            seed: Of all draws; each flight has its own by its name.

        Raises:
            ModelError: It has not learned to generate.
        """
        if not (self.system.autoencoder or self.info.protocol == "generate"):
            raise ModelError(
                f"{self.name} was trained to {self.info.protocol}: it draws nothing without a "
                "measurement. Train it with the protocol generate."
            )
        return replace(self, draws=seed)

    @one_thread()
    @torch.no_grad()
    def run(self, flight: ResidualFlight) -> Corrected:
        """The whole flight; each span starts anew. There is no envelope and no alarm."""
        self.info.check_flight(flight)
        n = len(flight.t_s)
        correction = np.zeros(flight.virtual.shape)
        draws = self.info.seed if self.draws is None else self.draws
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(zlib.crc32(f"{draws} {flight.name}".encode()))
            protocol, horizon = self.info.protocol, self.info.horizon
            for span in sequences([flight], self.scaling, protocol, horizon):
                said = self._said(span).double().numpy()
                mean, scale = self.scaling.mean[span.phase], self.scaling.scale[span.phase]
                correction[span.rows] = mean + scale * said
        spread = self.expected[flight.phase]
        return Corrected(correction, spread, no_alarm(n), np.ones(n, dtype=np.bool_))

    def _said(self, span: SpanSequence) -> Tensor:
        """Standardised residuals of a span, shape (n, 15)."""
        given = given_of(span, type(self.system), self.info.protocol)
        phase = _tensor(one_hot(span.phase))
        rows = torch.from_numpy(self._windows(len(phase)))  # (windows, length)
        if self.draws is None and self.info.protocol != "generate":
            said = self.system.reconstruct(given[rows], phase[rows])
        else:
            said = self.system.generate(phase[rows], self.prior)
        found = torch.zeros(len(phase), said.shape[-1])
        found[rows.flatten()] = said.flatten(0, 1)
        return found

    def _windows(self, n: int) -> NDArray[np.intp]:
        """Rows that go through the network together, shape (windows, length).

        Whatever sees no later sample gets the whole span; else windows of the training's length, of
        which the last reaches back.
        """
        length = min(self.info.preset.window, n) if self.system.sees_ahead else n
        starts = [*range(0, n - length, length), n - length]
        return np.asarray(np.array(starts)[:, None] + np.arange(length))

    def tensors(self) -> dict[str, NDArray[Any]]:
        """Weights, scaling, prior."""
        network = {k: v.detach().cpu().numpy() for k, v in self.system.state_dict().items()}
        return {
            **{_NETWORK + k: v for k, v in network.items()},
            **{_SCALING + k: v for k, v in self.scaling.arrays().items()},
            **{_PRIOR + k: v for k, v in self.prior.items()},
            _EXPECTED: self.expected,
        }

    def details(self) -> Mapping[str, Any]:
        """Nothing more."""
        return {}

    @classmethod
    def of_tensors(
        cls, info: ModelInfo[SystemPreset], name: str, system: System, tensors: Mapping[str, Any]
    ) -> "SystemModel":
        """The model that has these numbers; the system's weights are overwritten.

        Raises:
            KeyError, RuntimeError, ValueError: They do not fit.
        """
        scaling = Scaling(**_under(tensors, _SCALING))
        weights = {k: torch.from_numpy(v) for k, v in _under(tensors, _NETWORK).items()}
        system.load_state_dict(weights)
        expected = tensors[_EXPECTED]
        if expected.shape != (N_PHASES, len(info.channels)):
            raise ValueError(f"expected spread of shape {expected.shape}")
        return cls(info, name, system.eval(), scaling, _under(tensors, _PRIOR), expected)


def given_of(span: SpanSequence, system: type[System], protocol: Protocol) -> Tensor:
    """What a system may see of a span, float32, shape (n, given).

    In `generate` nothing; but what an autoencoder learns from is the residual itself.
    """
    if protocol == "free":
        return _tensor(span.features)
    if protocol == "generate":
        return _tensor(span.d if system.autoencoder else span.d[:, :0])
    return _tensor(span.lags[..., 0])


def _tensor(values: Array) -> Tensor:
    return torch.from_numpy(values.astype(np.float32))


def _under(tensors: Mapping[str, Any], prefix: str) -> dict[str, Any]:
    return {k.removeprefix(prefix): v for k, v in tensors.items() if k.startswith(prefix)}
