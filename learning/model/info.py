"""What a trained compensator says of itself, whatever its family."""

from dataclasses import dataclass, field
from typing import Any, Generic, TypeVar

from twin.errors import ModelError
from twin.representation import short_repr

from ..data.clustering import Clusters
from ..data.flights import ResidualFlight
from ..preset import Protocol

P = TypeVar("P")


@dataclass(frozen=True, slots=True)
class ModelInfo(Generic[P]):
    """What a model is, besides its numbers: content of `model.json`.

    Attributes:
        preset: Hyper-parameters, in the dataclass of the family.
        protocol: Which measurements it sees.
        horizon: Age of the newest residual it sees in `track`, samples; else 0.
        rate_hz: Samples per second that it must be called with.
        n_commands: Motor commands it sees, or what stands for them.
        clusters: Channels of each network; () in a family that has none.
        seed: Of the training.
        vehicle: Name of the twin's vehicle, "" where not said.
        vehicle_sha256: Of the vehicle's file.
        flights: Of the training: name, sha256, samples, seconds.
        training: Hash of all that decides the numbers.
        metrics: As measured on the validation time, where the family keeps some.
    """

    preset: P
    protocol: Protocol
    horizon: int
    rate_hz: float
    n_commands: int
    clusters: Clusters = ()
    seed: int = 0
    vehicle: str = ""
    vehicle_sha256: str = ""
    flights: tuple[dict[str, Any], ...] = ()
    training: str = ""
    metrics: dict[str, Any] = field(default_factory=dict)

    __repr__ = short_repr

    def check_flight(self, flight: ResidualFlight) -> None:
        """Raise ModelError unless the flight has the model's rate and commands."""
        if flight.rate_hz != self.rate_hz:
            raise ModelError(
                f"{flight.name}: residuals at {flight.rate_hz:g} Hz, the model was trained at "
                f"{self.rate_hz:g} Hz; make them anew at the model's rate"
            )
        if flight.commands.shape[1] != self.n_commands:
            raise ModelError(
                f"{flight.name}: {flight.commands.shape[1]} motor commands, the model was trained "
                f"with {self.n_commands}; it is good for aircraft of that many motors only"
            )
