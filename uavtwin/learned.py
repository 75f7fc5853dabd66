"""Compensators from Python: train one, evaluate one. Needs the extra `learn`, where it is used."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from twin.errors import TwinError
from twin.logs import Flight
from twin.vehicle import Vehicle

from .flights import checked_flights
from .shown import Shown, TextTable, counted
from .vehicles import checked_vehicle

if TYPE_CHECKING:
    from learning.model.family import TrainedModel
    from learning.preset import Protocol

    from .evaluation import Evaluation

Progress = Callable[[float], None]


@dataclass(frozen=True, slots=True, repr=False)
class TrainResult(Shown):
    """A trained compensator.

    Attributes:
        folder: That holds it: weights, ONNX, vehicle, learning curve, page.
        files: Names of what was written, the page first.
        claim: What it is good for, in one sentence.
    """

    folder: Path
    files: tuple[str, ...]
    claim: str

    def model(self) -> "TrainedModel":
        """The model itself."""
        from learning.model.folder import load

        return load(self.folder)

    def sections(self) -> Iterable[str | TextTable]:
        """The claim, and where the files are."""
        yield self.claim
        yield f"written to {self.folder}: {', '.join(self.files)}"

    def brief(self) -> str:
        """Folder and number of files."""
        return f"{type(self).__name__}: {self.folder.name}, {counted(self.files, 'file')}"


def train(
    flights: Flight | Sequence[Flight],
    vehicle: Vehicle,
    folder: str | Path,
    *,
    preset: str = "best",
    protocol: "Protocol" = "track",
    horizon: int = 1,
    rate_hz: float = 100.0,
    epochs: int | None = None,
    seed: int = 0,
    force: bool = False,
    progress: Progress = lambda _: None,
) -> TrainResult:
    """Train a compensator on what a vehicle leaves unexplained in flights.

    A training that was interrupted goes on where it was when it is called again.

    Args:
        flights: To train on.
        vehicle: Whose twin is to be corrected.
        folder: To write the model into.
        preset: `best`: ours; `paper`: the paper's text; `published`: its code; `linear`: no
            network; others in docs/guide/compensator.md.
        protocol: `track`: it sees residuals as old as the horizon; `free`: none; `reconstruct`:
            the present one.
        horizon: Of `track`, samples.
        rate_hz: Samples per second: 1000 over an integer.
        epochs: Default: the preset's; none for a preset in closed form.
        seed: Of everything that is drawn.
        force: Whether the folder may hold other files already.
        progress: Called with the share done, 0..1.

    Raises:
        TwinError: The extra `learn` is not installed, or an argument or a flight cannot be used.
    """
    with extra_learn():
        from . import training
    several, model = checked_flights(flights, "train"), checked_vehicle(vehicle, "train")
    out = Path(folder)
    plan = training.plan_training(preset, protocol, horizon, epochs, seed, out, force)
    residuals = training.prepare(several, model, rate_hz, lambda done: progress(0.1 * done))
    written = training.run_training(
        plan, residuals, model, out, lambda done: progress(0.1 + 0.9 * done)
    )
    return TrainResult(out, tuple(written), training.training_claim(out))


def evaluate(
    model: TrainResult | str | Path,
    flights: Flight | Sequence[Flight],
    *,
    explained: Vehicle | None = None,
    progress: Progress = lambda _: None,
) -> "Evaluation":
    """Measure a compensator on other flights, beside trivial baselines.

    Args:
        model: What `train` returned, or the folder that it wrote.
        flights: That it was not trained on.
        explained: Vehicle that `explain` found, drawn beside the model's own.
        progress: Called with the share done, 0..1.

    Raises:
        TwinError: The extra `learn` is not installed, the folder holds no model, or a flight was
            trained on or cannot be compared.
    """
    with extra_learn():
        from .evaluation import evaluate_model
    several = checked_flights(flights, "evaluate")
    other = None if explained is None else checked_vehicle(explained, "evaluate")
    folder = model.folder if isinstance(model, TrainResult) else Path(model)
    return evaluate_model(folder, several, other, progress)


@contextmanager
def extra_learn() -> Iterator[None]:
    """Around an import that needs torch: a machine that only runs models has none.

    Raises:
        TwinError: What is imported is not installed; the text says how to install it.
    """
    try:
        yield
    except ModuleNotFoundError as error:
        raise TwinError(
            f"{error.name} is not installed; training and evaluation need the extra `learn`: "
            "pip install 'uavtwin[learn]'"
        ) from error
