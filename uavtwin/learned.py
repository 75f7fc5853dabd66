"""Compensators from Python: training and evaluation. Needs the extra `learn`, on use."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass, field, replace
from functools import wraps
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, ParamSpec, TypeVar

from twin.errors import TwinError, install_command
from twin.formatting import counted
from twin.logs import Flight
from twin.vehicle import Vehicle

from .display import DisplayMixin, TextTable
from .flights import checked_flights
from .model_card import UNSAID, check_license
from .output import check_folder, results_folder
from .record import Record
from .vehicles import checked_vehicle

if TYPE_CHECKING:
    from learning.force.model import ForceModel
    from learning.model.family import TrainedModel
    from learning.preset import Protocol

    from .compensators.evaluation import Evaluation
    from .force.evaluate import ForceEvaluation
    from .vehicles import Vehicle as OwnVehicle

Progress = Callable[[float], None]
_P = ParamSpec("_P")
_R = TypeVar("_R")


class TrainRecord(Record, frozen=True, kw_only=True):
    """Result of a training.

    Attributes:
        claim: Purpose and benefit of the model, in one sentence.
        files: Names of the written files, the page first.
        seed: Seed of all random numbers.
        options: Options of the training, defaults filled in, by name.
    """

    claim: str
    files: tuple[str, ...]
    seed: int
    options: dict[str, Any]


@dataclass(frozen=True, slots=True, repr=False)
class TrainResult(DisplayMixin):
    """A trained compensator.

    Attributes:
        folder: Folder of the model: weights, ONNX, vehicle, learning curve, page.
        files: Names of the written files, the page first.
        claim: Purpose and benefit of the model, in one sentence.
        seed: Seed of all random numbers.
        options: Options of the training, defaults filled in.
        tables: Effect of the model on each reading in use.
    """

    folder: Path
    files: tuple[str, ...]
    claim: str
    seed: int = 0
    options: Mapping[str, Any] = field(default_factory=dict)
    tables: tuple[TextTable, ...] = ()

    @property
    def record(self) -> TrainRecord:
        """The content of `--json`."""
        return TrainRecord(
            claim=self.claim, files=self.files, seed=self.seed, options=dict(self.options)
        )

    def model(self) -> "TrainedModel | ForceModel":
        """Path of the model itself."""
        from learning.force.model import is_force, load_force

        if is_force(self.folder):
            return load_force(self.folder)
        from learning.model.folder import load

        return load(self.folder)

    def findings(self) -> Iterable[str | TextTable]:
        """Purpose, effect in use, and paths of the files."""
        yield self.claim
        yield from self.tables
        yield f"written to {self.folder}: {', '.join(self.files)}"

    def brief(self) -> str:
        """Folder and number of files."""
        return f"{type(self).__name__}: {self.folder.name}, {counted(self.files, 'file')}"


def _in_one_thread(verb: Callable[_P, _R]) -> Callable[_P, _R]:
    """The function with one thread of torch and BLAS: with several threads sums are rounded
    differently."""

    @wraps(verb)
    def _inside(*args: _P.args, **named: _P.kwargs) -> _R:
        with extra_learn():
            from learning.compute import one_thread
        with one_thread():
            return verb(*args, **named)

    return _inside


def train(
    flights: Flight | Sequence[Flight],
    vehicle: Vehicle,
    folder: str | Path,
    *,
    model: str | None = None,
    preset: str | None = None,
    protocol: 'Protocol | Literal["force"]' = "track",
    horizon: int = 1,
    rate_hz: float | None = None,
    epochs: int | None = None,
    seed: int | None = None,
    device: str = "cpu",
    license: str = UNSAID,
    law: str | Path | None = None,
    force: bool = False,
    progress: Progress = lambda _: None,
) -> TrainResult:
    """Train a compensator on the residuals of a vehicle in flights.

    After an interruption the same call resumes the training.

    Args:
        flights: Flights to train on.
        vehicle: Vehicle whose twin is corrected.
        folder: Folder of the model.
        model: `svq`: the project's own model, default except for `free` without epochs; `linear`:
            no network, the default there.
        preset: Preset of the model. For `svq`: `best`: the project's own, `paper`: the paper's
            text, `published`: its code.
        protocol: `force`: force and moment inside the equations. For the sensors: `track`:
            residuals of the age of the horizon are inputs; `free`: no residuals; `reconstruct`: the
            present ones.
        horizon: Samples between the newest residual and the prediction of `track`.
        rate_hz: Samples per second: 1000 over an integer; default: of `free` the IMU's, else 100.
        epochs: Default: the preset's; none for a preset in closed form.
        seed: Seed of all random numbers; default: the preset's, 0 in most.
        device: `cpu`; `cuda`: a GPU; `auto`: a GPU where torch finds one. The same seed gives the
            same bytes on `cpu` alone.
        license: License of the model, for its card, as Hugging Face names it: `cc-by-4.0`.
        law: Folder of a learned force: `free` corrects the sensors of the twin that has it, and the
            new folder holds both.
        force: Whether the folder may hold other files already.
        progress: Called with the completed share, 0..1.

    Raises:
        TwinError: The extra `learn` is not installed, or an argument or a flight cannot be used.
    """
    learned = None if law is None else Path(law)
    wanted = Wanted(
        model, preset, protocol, horizon, rate_hz, epochs, seed, device, license, learned
    )
    return run_train(flights, vehicle, Path(folder), wanted, force, progress)


@dataclass(frozen=True, slots=True)
class Wanted:
    """Arguments of `train` that determine the trained model."""

    model: str | None = None
    preset: str | None = None
    protocol: 'Protocol | Literal["force"]' = "track"
    horizon: int = 1
    rate_hz: float | None = None
    epochs: int | None = None
    seed: int | None = None
    device: str = "cpu"
    license: str = UNSAID
    law: Path | None = None


@_in_one_thread
def run_train(
    flights: Flight | Sequence[Flight],
    vehicle: Vehicle,
    out: Path,
    wanted: Wanted,
    force: bool = False,
    progress: Progress = lambda _: None,
    alongside: Callable[[TrainResult, Path], None] = lambda *_: None,
) -> TrainResult:
    """Train, and write the folder of the model atomically.

    Until then the folder contains a checkpoint only, with which the same call resumes.

    Args:
        flights, vehicle, force, progress: See `train`.
        out: Folder of the model.
        wanted: Settings of the training.
        alongside: Takes the result and writes further files into the given folder.

    Raises:
        TwinError: As `train`.
    """
    several, twin = checked_flights(flights, "train"), checked_vehicle(vehicle, "train")
    check_license(wanted.license)
    with extra_learn():
        prepare = _force_training if wanted.protocol == "force" else _sensor_training
        checkpoint, write = prepare(several, twin, out, wanted, force, progress)
    new = not out.exists()
    out.mkdir(parents=True, exist_ok=True)
    try:
        with results_folder(out, force, checkpoint) as folder:
            made = replace(write(folder), folder=out)
            alongside(made, folder)
    except BaseException:
        if new:
            with suppress(OSError):  # it contains a checkpoint
                out.rmdir()
        raise
    return made


_Prepared = tuple[str, Callable[[Path], TrainResult]]
"""Name of the checkpoint, and the function that trains and writes."""


def _sensor_training(
    flights: Sequence[Flight],
    vehicle: "OwnVehicle",
    out: Path,
    wanted: Wanted,
    force: bool,
    progress: Progress,
) -> _Prepared:
    """A compensator of the sensors, with checks before the training."""
    from learning.data.flights import DEFAULT_RATE_HZ
    from learning.force.model import is_force
    from learning.training.checkpoint import CHECKPOINT

    from .compensators import training
    from .model_card import write_card

    if is_force(out):
        raise TwinError(f"{out}: holds a learned force. Choose another folder, and give it as law.")
    plan = training.plan_training(wanted, out, force)
    usual_hz = training.imu_rate_hz(flights) if plan.task.protocol == "free" else DEFAULT_RATE_HZ
    rate_hz = wanted.rate_hz or usual_hz
    options = {
        "model": plan.family.name,
        "preset": plan.preset.name,
        "protocol": plan.task.protocol,
        "horizon": plan.task.horizon,
        "rate": rate_hz,
        "epochs": plan.epochs,
        "device": plan.task.device,
    }

    def write(folder: Path) -> TrainResult:
        """Train, and write the model and its card."""
        written = training.run_training(plan, flights, vehicle, rate_hz, folder, out, progress)
        claim = training.training_claim(folder)
        written.append(write_card(folder, claim, wanted.license))
        in_use = training.in_use_of(folder)
        tables = () if in_use is None else (in_use.table(),)
        return TrainResult(folder, tuple(written), claim, plan.task.seed, options, tables)

    return CHECKPOINT, write


def _force_training(
    flights: Sequence[Flight],
    vehicle: "OwnVehicle",
    out: Path,
    wanted: Wanted,
    force: bool,
    progress: Progress,
) -> _Prepared:
    """Force and moment inside the equations, with checks before the training."""
    from .force.memory import CHECKPOINT, Memory, training_key
    from .force.train import check_force_options, force_claim, train_force
    from .model_card import write_card

    check_force_options(wanted)
    if (out / "model.json").is_file():
        raise TwinError(f"{out}: holds a compensator of the sensors. Choose another folder.")
    check_folder(out, force, CHECKPOINT)
    seed = wanted.seed or 0

    def write(folder: Path) -> TrainResult:
        """Learn, and write the force and its card."""
        key = training_key(flights, vehicle, seed)
        with closing(Memory(out / CHECKPOINT, key)) as memory:
            made = train_force(flights, vehicle, seed, folder, memory, progress)
        claim = force_claim(folder)
        made.append(write_card(folder, claim, wanted.license))
        return TrainResult(folder, tuple(made), claim, seed, {"protocol": "force"})

    return CHECKPOINT, write


def write_measured_card(
    model: Path,
    found: "Evaluation | ForceEvaluation",
    flights: Sequence[Flight],
    folder: Path,
) -> str:
    """Write the card of a model with evaluation results; returns its name.

    Args:
        model: Folder of the model, which stays as it is.
        found: Result of `evaluate`.
        flights: Flights that it was measured on.
        folder: Folder of the copy.

    Raises:
        TwinError: The head of the model's own card cannot be read.
    """
    from learning.force.model import is_force

    if is_force(model):
        from .force.train import force_claim as claim
    else:
        from .compensators.training import training_claim as claim
    from .model_card import Measured, write_completed_card

    measured = Measured(found.json(), {f.name: f.fingerprint for f in flights})
    return write_completed_card(model, claim(model), measured, folder)


@_in_one_thread
def evaluate(
    model: TrainResult | str | Path,
    flights: Flight | Sequence[Flight],
    *,
    explained: Vehicle | None = None,
    physics: Vehicle | None = None,
    progress: Progress = lambda _: None,
) -> "Evaluation | ForceEvaluation":
    """Measure a compensator on other flights, against trivial baselines.

    Args:
        model: A result of `train`, the folder that it wrote, or the name of a shipped model.
        flights: Flights that did not train the model.
        explained: Vehicle that `explain` found, drawn with the model's own.
        physics: Original vehicle, simulated for comparison with a learned force.
        progress: Called with the completed share.

    Raises:
        TwinError: The extra `learn` is not installed, the folder holds no model, a flight was
            trained on or cannot be compared, or a vehicle is given that has no part in it.
    """
    from learning.force.model import is_force

    from .exports.parts import model_folder

    several = checked_flights(flights, "evaluate")
    folder = model.folder if isinstance(model, TrainResult) else model_folder(model)
    if is_force(folder):
        from .force.evaluate import evaluate_force

        _refuse("explained", explained, "a learned force: its own vehicle is the explained one")
        before = None if physics is None else checked_vehicle(physics, "evaluate")
        return evaluate_force(folder, several, before, progress)
    with extra_learn():
        from .compensators.evaluation import evaluate_model
    _refuse("physics", physics, "a compensator of the sensors: give the vehicle as explained")
    other = None if explained is None else checked_vehicle(explained, "evaluate")
    return evaluate_model(folder, several, other, progress)


def _refuse(name: str, given: Vehicle | None, model: str) -> None:
    """Refuse a vehicle that does not apply to an evaluation."""
    if given is not None:
        raise TwinError(f"evaluate: {name} does not go with {model}.")


def check_extra_learn() -> None:
    """Refuse to run without torch, before long computations.

    Raises:
        TwinError: It is not installed; the text says how to install it.
    """
    with extra_learn():
        if find_spec("torch") is None:
            raise ModuleNotFoundError("no torch", name="torch")


@contextmanager
def extra_learn() -> Iterator[None]:
    """Context for an import that needs torch, which a machine that only runs models lacks.

    Raises:
        TwinError: The package is not installed; the text says how to install it.
    """
    try:
        yield
    except ModuleNotFoundError as error:
        raise TwinError(
            f"{error.name} is not installed; training and evaluation need it: "
            f"{install_command('learn')}"
        ) from error
