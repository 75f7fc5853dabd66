"""A learned force and moment as a folder: one JSON file, and the vehicle it was learned for."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import msgspec
import numpy as np

from twin.errors import ModelError, TwinError
from twin.physics.residual_force import FEATURES, INPUTS, OUTPUTS, ForceLaw
from twin.representation import short_repr

from .forecast import Observer

FILE, VEHICLE_FILE = "force.json", "vehicle.toml"  # in the folder of a law
FORMAT = 4
"""Version of the file's layout."""
_OUTPUTS = tuple(f"{kind}_{a}" for kind, a in OUTPUTS)  # names in the file


@dataclass(frozen=True, slots=True)
class LawScore:
    """One law of one output, or its observer, over flights that took no part in its fit.

    Attributes:
        law: Of `learning.force.laws.LAWS`, or `observer`.
        gain: Nats by which the flights are more probable than without it; 0 of an observer, which
            flying alone decides on.
        ratio: Error over that without it, geometric mean over flights, quantities and horizons;
            None of one that was not flown, as nothing speaks for it.
        worst: The largest ratio of a quantity, flights and horizons together.
    """

    law: str
    gain: float
    ratio: float | None = None
    worst: float | None = None


@dataclass(frozen=True, slots=True)
class Output:
    """What was learned of one output.

    Attributes:
        law: That is used.
        observer: Of what it leaves.
        tried: Every law, as flown; empty where a single flight was given.
    """

    law: str
    observer: Observer
    tried: tuple[LawScore, ...] = ()


@dataclass(frozen=True, slots=True)
class TrainingFlight:
    """A flight that was learned from.

    Attributes:
        name: Of the flight.
        sha256: `Flight.fingerprint`.
    """

    name: str
    sha256: str


@dataclass(frozen=True, slots=True)
class MissionCheck:
    """Missions in random air that the chosen laws had to fly.

    Attributes:
        flights: How many; 0 where no law was chosen.
        lost: With all chosen laws, of those that are flown without.
        withdrawn: What is not used for that.
    """

    flights: int
    lost: int
    withdrawn: tuple[str, ...]

    @classmethod
    def nothing(cls) -> "MissionCheck":
        """No law, and none flown."""
        return cls(0, 0, ())


@dataclass(frozen=True, slots=True)
class Acceptance:
    """The chosen laws with their observers on flights left out, against what needs no law.

    Attributes:
        over_observer: Error over that of the explained twin with the untrained observer, median
            over flights, quantities and horizons; None where no law was chosen.
        over_last_motion: Position and velocity over those of the last motion, 0.5 s after the twin
            was left alone, geometric mean over flights; None where no law was chosen.
        withdrawn: Laws that are not used, as they do not beat both.
    """

    over_observer: float | None = None
    over_last_motion: float | None = None
    withdrawn: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Rival:
    """Every output by one law.

    Attributes:
        law: Of all outputs.
        observers: Of what it leaves, one per output.
    """

    law: ForceLaw
    observers: tuple[Observer, ...]

    __repr__ = short_repr


@dataclass(frozen=True, slots=True)
class StoredArray:
    """An array as plain numbers.

    Attributes:
        shape: Of it.
        values: All of it, row by row.
    """

    shape: tuple[int, ...]
    values: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class StoredRival:
    """Every output by one law.

    Attributes:
        law: Its arrays, by name.
        observers: Of what it leaves, one per output.
    """

    law: dict[str, StoredArray]
    observers: tuple[Observer, ...]


@dataclass(frozen=True, slots=True)
class ForceFile:
    """What `uavtwin train --protocol force` writes beside `vehicle.toml`.

    Attributes:
        format: Version of the layout.
        protocol: "force".
        vehicle: Name of the vehicle.
        vehicle_sha256: Of its file.
        seed: Of the air of the missions that it had to fly.
        flights: That taught it.
        inputs: Names of what the law sees.
        features: Names of what its linear part is linear in.
        outputs: Of each of the six, by name.
        acceptance: What they were held against before, on flights left out.
        closed_loop: Missions in random air, flown before the laws were shipped.
        taken_1_s: Largest rate at which the linear part would have fed energy in; taken out.
        law: Arrays of the law that is used, by name.
        rivals: Every output by one law, by its name.
    """

    format: int
    protocol: str
    vehicle: str
    vehicle_sha256: str
    seed: int
    flights: tuple[TrainingFlight, ...]
    inputs: tuple[str, ...]
    features: tuple[str, ...]
    outputs: dict[str, Output]
    acceptance: Acceptance
    closed_loop: MissionCheck
    taken_1_s: float
    law: dict[str, StoredArray]
    rivals: dict[str, StoredRival]


@dataclass(frozen=True, slots=True)
class ForceModel:
    """A law, the observer alongside it, and how both were come by.

    Attributes:
        law: As it is used.
        rivals: The same with every output by one law, by its name.
        outputs: Of `OUTPUTS`, in order.
        closed_loop: What was withdrawn before, because it lost missions.
        taken: Largest rate at which the linear part would have fed energy in, 1/s; taken out.
        flights: That taught it.
        vehicle: Name of the vehicle.
        vehicle_sha256: Of its file.
        seed: Of the air of the missions that it had to fly.
        acceptance: What the chosen laws were held against.
    """

    law: ForceLaw
    rivals: Mapping[str, Rival]
    outputs: tuple[Output, ...]
    closed_loop: MissionCheck
    taken: float
    flights: tuple[TrainingFlight, ...]
    vehicle: str
    vehicle_sha256: str
    seed: int
    acceptance: Acceptance = Acceptance()

    __repr__ = short_repr

    @property
    def observer_starts(self) -> dict[str, float]:
        """Parameters of a driven twin by which its observer is that of the law."""
        return observer_starts([o.observer for o in self.outputs])


def observer_starts(observers: Sequence[Observer]) -> dict[str, float]:
    """Parameters of a driven twin by which its observer has these numbers, one per output."""
    starts = {"airframe.disturbance.enabled": 1.0}
    for name, observer in zip(_OUTPUTS, observers, strict=True):
        starts[f"airframe.disturbance.lag.{name}"] = observer.lag_s
        starts[f"airframe.disturbance.fade.{name}"] = observer.fade_s
    return starts


def save_force(model: ForceModel, folder: Path) -> None:
    """Write `force.json`; the same model gives the same bytes."""
    content = ForceFile(
        format=FORMAT,
        protocol="force",
        vehicle=model.vehicle,
        vehicle_sha256=model.vehicle_sha256,
        seed=model.seed,
        flights=model.flights,
        inputs=tuple(name for name, _ in INPUTS),
        features=tuple(FEATURES),
        outputs=dict(zip(_OUTPUTS, model.outputs, strict=True)),
        acceptance=model.acceptance,
        closed_loop=model.closed_loop,
        taken_1_s=model.taken,
        law=_plain(model.law),
        rivals={
            name: StoredRival(_plain(rival.law), rival.observers)
            for name, rival in model.rivals.items()
        },
    )
    text = json.dumps(asdict(content), indent=1, allow_nan=False)
    (folder / FILE).write_text(text + "\n", "utf-8")


def load_force(folder: Path) -> ForceModel:
    """The model of a folder.

    Raises:
        ModelError: The folder holds none, or one of another layout or version.
    """
    path = folder / FILE
    if not path.is_file():
        raise ModelError(f"{folder}: no {FILE}; `uavtwin train --protocol force` writes one.")
    try:
        content = json.loads(path.read_text("utf-8"))
        file = msgspec.convert(content, ForceFile)
        if msgspec.json.decode(msgspec.json.encode(file)) != content:
            raise ModelError("it has keys that are none of its own")
        return _model(file)
    except (msgspec.MsgspecError, KeyError, TypeError, ValueError, TwinError) as error:
        raise ModelError(
            f"{path}: is of another layout than this version's, or damaged ({error}). Train the "
            f"model again."
        ) from error


def is_force(folder: Path) -> bool:
    """Whether a folder holds a learned force."""
    return (folder / FILE).is_file()


def _model(content: ForceFile) -> ForceModel:
    expected = {
        "format": FORMAT,
        "inputs": tuple(name for name, _ in INPUTS),
        "features": tuple(FEATURES),
    }
    for key, value in expected.items():
        if getattr(content, key) != value:
            raise ModelError(f"{key} is {getattr(content, key)}, not {value}")
    if tuple(content.outputs) != _OUTPUTS:
        raise ModelError(f"outputs are {list(content.outputs)}, not {list(_OUTPUTS)}")
    return ForceModel(
        law=_law(content.law),
        rivals={n: Rival(_law(r.law), r.observers) for n, r in content.rivals.items()},
        outputs=tuple(content.outputs.values()),
        acceptance=content.acceptance,
        closed_loop=content.closed_loop,
        taken=content.taken_1_s,
        flights=content.flights,
        vehicle=content.vehicle,
        vehicle_sha256=content.vehicle_sha256,
        seed=content.seed,
    )


def _plain(law: ForceLaw) -> dict[str, StoredArray]:
    """A law as plain numbers; the shape of a table without rows is said, too."""
    return {k: StoredArray(v.shape, tuple(v.ravel().tolist())) for k, v in law.arrays().items()}


def _law(content: Mapping[str, StoredArray]) -> ForceLaw:
    return ForceLaw.of(
        {k: np.array(v.values, dtype=np.float64).reshape(v.shape) for k, v in content.items()}
    )
