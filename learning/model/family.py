"""What a family of compensators must offer, and what every model says of itself and of a flight."""

import hashlib
import json
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, ClassVar, Generic, TypeVar
from typing import Protocol as Interface

import numpy as np
from numpy.typing import NDArray

from twin.errors import ModelError
from twin.representation import short_repr

from ..data.clustering import Clusters
from ..data.flights import ResidualFlight
from ..data.scaling import in_spans
from ..data.sequences import check_protocol
from ..preset import Protocol

Array = NDArray[np.float64]
BoolArray = NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class Corrected:
    """A flight with its correction; outside the spans nothing is corrected.

    Attributes:
        correction: To be added to what the twin reads, shape (n, 15), units of the channels.
        spread: Standard deviation expected of what is left, shape (n, 15).
        anomaly: How strange the newest readings are, or what is known in their place, above 1
            rarely, (n,); NaN where a model gives no alarm.
        inside: Whether the features are within the envelope of the training data, shape (n,).
    """

    correction: Array
    spread: Array
    anomaly: Array
    inside: BoolArray

    __repr__ = short_repr


def between(share: Array, corrected: Array, uncorrected: Array) -> Array:
    """Spread of what is left where a correction fades: the one at share 1, the other at 0."""
    return uncorrected + share * (corrected - uncorrected)


class Model(Interface):
    """Whatever corrects a flight."""

    def run(self, flight: ResidualFlight) -> Corrected:
        """The whole flight; each span starts from zero."""
        ...


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
                f"{self.rate_hz:g} Hz; make them again at the model's rate"
            )
        if flight.commands.shape[1] != self.n_commands:
            raise ModelError(
                f"{flight.name}: {flight.commands.shape[1]} motor commands, the model was trained "
                f"with {self.n_commands}; it is good for aircraft of that many motors only"
            )


Progress = Callable[[float, float | None], None]
"""Called with the share done, 0..1, and the seconds left, None while not known."""
Tensors = Mapping[str, NDArray[Any]]


class FamilyPreset(Interface):
    """Hyper-parameters: a frozen dataclass of numbers, texts and tuples of them.

    One whose training takes several passes says so by a field `epochs`.
    """

    __dataclass_fields__: ClassVar[dict[str, Any]]

    @property
    def name(self) -> str:
        """As printed, and as `uavtwin train --preset` takes it."""
        ...


class TrainedModel(Interface):
    """A compensator that was trained, of any family."""

    @property
    def family(self) -> str:
        """Name of its family in `registry.FAMILIES`."""
        ...

    @property
    def info(self) -> ModelInfo[Any]:
        """What it is."""
        ...

    def run(self, flight: ResidualFlight) -> Corrected:
        """The whole flight; each span starts from zero.

        Raises:
            ModelError: Rate or number of commands differs from the training's.
        """
        ...

    def tensors(self) -> Tensors:
        """All its numbers, for `weights.safetensors`."""
        ...

    def details(self) -> Mapping[str, Any]:
        """What the family adds to `model.json`; JSON content."""
        ...


@dataclass(frozen=True, slots=True)
class TrainingTask:
    """What a model is trained for or measured in, whatever its family and preset.

    Attributes:
        protocol: What it sees.
        horizon: Samples, in `track`; else 0.
        seed: Of everything that is drawn.
        vehicle: Name of the twin's vehicle, to be written down.
        vehicle_sha256: Of its file.
        device: On which a network is trained, as of `learning.compute`: it decides rounding alone.
        checkpoints: Folder of the checkpoint, which stays there at the end; None: that of the
            model, from which it is removed.
    """

    protocol: Protocol
    horizon: int = 0
    seed: int = 0
    vehicle: str = ""
    vehicle_sha256: str = ""
    device: str = "cpu"
    checkpoints: Path | None = None

    def __post_init__(self) -> None:
        """Raise ModelError unless the horizon goes with the protocol."""
        check_protocol(self.protocol, self.horizon)


PresetT = TypeVar("PresetT", bound=FamilyPreset)
ModelT = TypeVar("ModelT", bound=TrainedModel)


class Family(ABC, Generic[PresetT, ModelT]):
    """One kind of compensator; docs/dev/extending/compensator_model.md adds one step by step.

    Attributes:
        name: As in `registry.FAMILIES` and `model.json`.
        meaning: What its models are, in a line.
        presets: By name, all of one dataclass; no two families have a name in common.
        usual: Preset where nobody says.
        onnx: Whether its models are exported as `model.onnx`, and so as FMUs.
    """

    name: ClassVar[str]
    meaning: ClassVar[str]
    presets: ClassVar[Mapping[str, Any]]
    usual: ClassVar[str]
    onnx: ClassVar[bool]

    @abstractmethod
    def protocols(self, preset: PresetT) -> Sequence[Protocol]:
        """Under which protocols the preset can be trained."""

    @abstractmethod
    def fit(
        self,
        flights: Sequence[ResidualFlight],
        preset: PresetT,
        task: TrainingTask,
        folder: Path,
        progress: Progress,
    ) -> ModelT:
        """Train on flights of one rate and number of commands; the same seed gives the same bytes.

        Args:
            flights: Checked by `check_flights`.
            preset: Hyper-parameters.
            task: Its protocol is one of `protocols`.
            folder: Exists; for a checkpoint and the learning curve. The model itself is written
                there by the caller.
            progress: To be called as the work goes on, where that takes more than seconds.
        """

    @abstractmethod
    def build(self, info: ModelInfo[PresetT], tensors: Tensors) -> ModelT:
        """The model that has these numbers.

        Args:
            info: As it was saved.
            tensors: As `TrainedModel.tensors` gave them.

        Raises:
            KeyError, TypeError, ValueError, RuntimeError: They do not fit each other.
        """

    @abstractmethod
    def export(self, model: ModelT, folder: Path) -> tuple[str, ...]:
        """Write what other runtimes need (`model.onnx`); names of the files, () without any."""


def silent(done: float, left_s: float | None) -> None:
    """Progress that nobody looks at."""


def no_alarm(n: int) -> NDArray[np.float64]:
    """Anomaly of a model that gives none, shape (n,)."""
    return np.full(n, np.nan)


def check_flights(flights: Sequence[ResidualFlight]) -> None:
    """Raise ModelError unless there are flights, of one kind, each with a measured residual."""
    if not flights:
        raise ModelError("training needs at least one flight")
    kinds = {(f.rate_hz, f.commands.shape[1]) for f in flights}
    if len(kinds) > 1:
        said = ", ".join(f"{r:g} Hz with {m} motor commands" for r, m in sorted(kinds))
        raise ModelError(f"training flights differ: {said}; train on flights of one kind")
    for flight in flights:
        if not flight.spans or not flight.fresh[in_spans(flight)].any():
            raise ModelError(
                f"{flight.name}: no span with a measured residual; leave this flight out"
            )


def describe_flight(flight: ResidualFlight) -> dict[str, Any]:
    """Name, sha256 of all its numbers and of its log's, samples and seconds in the air."""
    digest = hashlib.sha256(np.array(flight.spans, dtype=np.int64).tobytes())
    arrays = (flight.t_s, flight.virtual, flight.residual, flight.commands)
    for array in (*arrays, flight.fresh, flight.phase.astype(np.int64), flight.alone_rows):
        digest.update(np.ascontiguousarray(array).tobytes())
    samples = int(in_spans(flight).sum())
    return {
        "name": flight.name,
        "sha256": digest.hexdigest(),
        "log_sha256": flight.log_sha256,
        "samples": samples,
        "seconds": samples / flight.rate_hz,
    }


def describe_training(
    family: str, flights: Sequence[ResidualFlight], preset: PresetT, task: TrainingTask
) -> ModelInfo[PresetT]:
    """What a model of these flights says of itself, before it is trained.

    Args:
        family: Name.
        flights: Of the training.
        preset: A frozen dataclass.
        task: Protocol, horizon, seed, vehicle.
    """
    about = [describe_flight(f) for f in flights]
    decides = [family, asdict(preset), task.protocol, task.horizon, task.seed, about]
    return ModelInfo(
        preset=preset,
        protocol=task.protocol,
        horizon=task.horizon,
        rate_hz=flights[0].rate_hz,
        n_commands=flights[0].commands.shape[1],
        seed=task.seed,
        vehicle=task.vehicle,
        vehicle_sha256=task.vehicle_sha256,
        flights=tuple(about),
        training=hashlib.sha256(json.dumps(decides, sort_keys=True).encode()).hexdigest(),
    )
