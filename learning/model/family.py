"""What a family of compensators must offer, so that all are trained, kept and compared alike."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Generic, TypeVar
from typing import Protocol as Interface

import numpy as np
from numpy.typing import NDArray

from ..data.flights import ResidualFlight
from ..preset import Protocol
from .corrected import Corrected
from .info import ModelInfo

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
        """The whole flight; each span starts anew.

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
    """What a model is trained for, whatever its family and preset.

    Attributes:
        protocol: What it sees.
        horizon: Samples, in `track`; else 0.
        seed: Of everything that is drawn.
        vehicle: Name of the twin's vehicle, to be written down.
        vehicle_sha256: Of its file.
        device: On which a network is trained, as of `learning.devices`: it decides rounding alone.
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


PresetT = TypeVar("PresetT", bound=FamilyPreset)
ModelT = TypeVar("ModelT", bound=TrainedModel)


class Family(ABC, Generic[PresetT, ModelT]):
    """One kind of compensator; docs/dev/extending/compensator_model.md adds one step by step."""

    @abstractmethod
    def presets(self) -> Mapping[str, PresetT]:
        """Its presets by name, all of one dataclass; the row in the registry names the same."""

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
            flights: Checked by `training.inputs.check_flights`.
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
        """Write what other runtimes need (`model.onnx`); names of the files, () without any.

        Whether there are any is what the row in the registry says by `onnx`.
        """


def silent(done: float, left_s: float | None) -> None:
    """Progress that nobody looks at."""


def no_alarm(n: int) -> NDArray[np.float64]:
    """Anomaly of a model that gives none, shape (n,)."""
    return np.full(n, np.nan)
