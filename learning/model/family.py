"""Interfaces of a compensator family, its models and its training tasks."""

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
from twin.representation import ShortRepr

from ..data.clustering import Clusters
from ..data.flights import ResidualFlight
from ..data.scaling import in_spans
from ..data.sequences import check_protocol
from ..preset import Protocol

Array = NDArray[np.float64]
BoolArray = NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class Corrected(ShortRepr):
    """Correction of a flight; zero outside the spans.

    Attributes:
        correction: Correction added to the twin's readings, shape (n, 15), units of the channels.
        spread: Predicted standard deviation of the remaining error, shape (n, 15).
        anomaly: Anomaly score of the newest readings, or of other known data, rarely above 1, shape
            (n,); NaN for a model without alarms.
        inside: Whether the features are inside the training envelope, shape (n,).
    """

    correction: Array
    spread: Array
    anomaly: Array
    inside: BoolArray


def between(share: Array, corrected: Array, uncorrected: Array) -> Array:
    """Spread where a correction fades: `corrected` at share 1, `uncorrected` at 0."""
    return uncorrected + share * (corrected - uncorrected)


class Model(Interface):
    """Interface of anything that corrects a flight."""

    def run(self, flight: ResidualFlight) -> Corrected:
        """Correction of the whole flight; each span starts from zero state."""
        ...


P = TypeVar("P")


@dataclass(frozen=True, slots=True)
class ModelInfo(ShortRepr, Generic[P]):
    """Description of a model without its weights: content of `model.json`.

    Attributes:
        preset: Hyper-parameters, a dataclass of the family.
        protocol: Protocol: which measurements the model sees.
        horizon: Age of the newest residual that it sees in `track`, samples; otherwise 0.
        rate_hz: Sample rate at which it must be called, Hz.
        n_commands: Number of motor commands, or of rotor speeds that replace them.
        clusters: Channels of each network; () for a family without clusters.
        seed: Random seed of the training.
        vehicle: Name of the twin's vehicle, "" where unknown.
        vehicle_sha256: SHA-256 hash of the vehicle file.
        flights: Training flights: name, sha256, samples, seconds.
        training: Hash of all inputs that determine the weights.
        metrics: Errors on the validation data, where the family stores some.
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

    def check_flight(self, flight: ResidualFlight) -> None:
        """Raise ModelError unless the flight has the model's rate and number of commands."""
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
"""Callback with the share done, 0..1, and the remaining time, s, None while unknown."""
Tensors = Mapping[str, NDArray[Any]]


class FamilyPreset(Interface):
    """Hyper-parameters: a frozen dataclass of numbers, texts and tuples of them.

    A preset whose training takes several passes has a field `epochs`.
    """

    __dataclass_fields__: ClassVar[dict[str, Any]]

    @property
    def name(self) -> str:
        """Name as printed, and as option of `uavtwin train --preset`."""
        ...


class TrainedModel(Model, Interface):
    """A trained compensator of any family; `run` raises ModelError where rate or number of commands
    differs from the training."""

    @property
    def family(self) -> str:
        """Name of its family in `registry.FAMILIES`."""
        ...

    @property
    def info(self) -> ModelInfo[Any]:
        """Description of the model."""
        ...

    def tensors(self) -> Tensors:
        """All weights, for `weights.safetensors`."""
        ...

    def details(self) -> Mapping[str, Any]:
        """Family-specific content of `model.json`."""
        ...


@dataclass(frozen=True, slots=True)
class TrainingTask:
    """Task of a training or evaluation, independent of family and preset.

    Attributes:
        protocol: Protocol: which measurements the model sees.
        horizon: Age of the newest residual, samples, in `track`; otherwise 0.
        seed: Random seed.
        vehicle: Name of the twin's vehicle, for the description.
        vehicle_sha256: SHA-256 hash of the vehicle file.
        device: Device on which a network is trained, as of `learning.compute`; it influences only
            rounding.
        checkpoints: Folder of the checkpoint, which remains at the end; None: that of the model,
            from which it is removed.
    """

    protocol: Protocol
    horizon: int = 0
    seed: int = 0
    vehicle: str = ""
    vehicle_sha256: str = ""
    device: str = "cpu"
    checkpoints: Path | None = None

    def __post_init__(self) -> None:
        """Raise ModelError unless the horizon is allowed with the protocol."""
        check_protocol(self.protocol, self.horizon)


PresetT = TypeVar("PresetT", bound=FamilyPreset)
ModelT = TypeVar("ModelT", bound=TrainedModel)


class Family(ABC, Generic[PresetT, ModelT]):
    """A family of compensators; docs/dev/extending/compensator_model.md adds one step by step.

    Attributes:
        name: Name in `registry.FAMILIES` and `model.json`.
        meaning: Description of its models in one line.
        presets: Presets by name, all of one dataclass; names are unique over all families.
        usual: Default preset.
        onnx: Whether its models are exported as `model.onnx`, and therefore as FMUs.
    """

    name: ClassVar[str]
    meaning: ClassVar[str]
    presets: ClassVar[Mapping[str, Any]]
    usual: ClassVar[str]
    onnx: ClassVar[bool]

    @abstractmethod
    def protocols(self, preset: PresetT) -> Sequence[Protocol]:
        """Protocols under which the preset can be trained."""

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
            flights: Training flights, checked by `check_flights`.
            preset: Hyper-parameters.
            task: Training task; its protocol is one of `protocols`.
            folder: Existing folder for a checkpoint and the learning curve. The caller writes the
                model there.
            progress: Called with the share done, where the training takes more than seconds.
        """

    @abstractmethod
    def build(self, info: ModelInfo[PresetT], tensors: Tensors) -> ModelT:
        """Model from its stored weights.

        Args:
            info: Description, as stored.
            tensors: Weights, as of `TrainedModel.tensors`.

        Raises:
            KeyError, TypeError, ValueError, RuntimeError: Description and weights do not match.
        """

    @abstractmethod
    def export(self, model: ModelT, folder: Path) -> tuple[str, ...]:
        """Write files for other runtimes (`model.onnx`); returns their names, () without any."""


def silent(done: float, left_s: float | None) -> None:
    """Progress callback that does nothing."""


def no_alarm(n: int) -> NDArray[np.float64]:
    """Anomaly score of a model without alarms, NaN, shape (n,)."""
    return np.full(n, np.nan)


def check_flights(flights: Sequence[ResidualFlight]) -> None:
    """Raise ModelError unless there are flights, of one rate and number of commands, each with a
    measured residual."""
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
    """Name, SHA-256 hashes of its numbers and of its log, samples and seconds in the air."""
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
    """Description of a model before it is trained.

    Args:
        family: Name of the family.
        flights: Training flights.
        preset: Preset, a frozen dataclass.
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
