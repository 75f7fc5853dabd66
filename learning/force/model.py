"""A learned force and moment as a folder: one JSON file, and the vehicle it was learned for."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin.errors import ModelError, TwinError
from twin.physics.residual_force import FEATURES, INPUTS, OUTPUTS, ForceLaw
from twin.representation import short_repr

from .forecast import Observer

FILE, VEHICLE_FILE = "force.json", "vehicle.toml"  # in the folder of a law
FORMAT = 3
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
    content = {
        "format": FORMAT,
        "protocol": "force",
        "vehicle": model.vehicle,
        "vehicle_sha256": model.vehicle_sha256,
        "seed": model.seed,
        "flights": [asdict(f) for f in model.flights],
        "inputs": [name for name, _ in INPUTS],
        "features": list(FEATURES),
        "outputs": {
            name: asdict(output) for name, output in zip(_OUTPUTS, model.outputs, strict=True)
        },
        "closed_loop": asdict(model.closed_loop),
        "taken_1_s": model.taken,
        "law": _plain(model.law),
        "rivals": {
            name: {"law": _plain(rival.law), "observers": [asdict(o) for o in rival.observers]}
            for name, rival in model.rivals.items()
        },
    }
    text = json.dumps(content, indent=1, allow_nan=False)
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
        return _model(content)
    except (AttributeError, KeyError, TypeError, ValueError, TwinError) as error:
        raise ModelError(
            f"{path}: is of another layout than this version's, or damaged ({error}). Train the "
            f"model again."
        ) from error


def is_force(folder: Path) -> bool:
    """Whether a folder holds a learned force."""
    return (folder / FILE).is_file()


def _model(content: Mapping[str, Any]) -> ForceModel:
    named = {
        "format": FORMAT,
        "inputs": [name for name, _ in INPUTS],
        "features": list(FEATURES),
    }
    for key, value in named.items():
        if content[key] != value:
            raise ModelError(f"{key} is {content[key]}, not {value}")
    if list(content["outputs"]) != list(_OUTPUTS):
        raise ModelError(f"outputs are {list(content['outputs'])}, not {list(_OUTPUTS)}")
    return ForceModel(
        law=_law(content["law"]),
        rivals={
            name: Rival(_law(said["law"]), tuple(Observer(**o) for o in said["observers"]))
            for name, said in content["rivals"].items()
        },
        outputs=tuple(
            Output(
                said["law"],
                Observer(**said["observer"]),
                tuple(LawScore(**f) for f in said["tried"]),
            )
            for said in content["outputs"].values()
        ),
        closed_loop=_checked(content["closed_loop"]),
        taken=float(content["taken_1_s"]),
        flights=tuple(TrainingFlight(**f) for f in content["flights"]),
        vehicle=str(content["vehicle"]),
        vehicle_sha256=str(content["vehicle_sha256"]),
        seed=int(content["seed"]),
    )


def _checked(content: Mapping[str, Any]) -> MissionCheck:
    return MissionCheck(int(content["flights"]), int(content["lost"]), tuple(content["withdrawn"]))


def _plain(law: ForceLaw) -> dict[str, Any]:
    """A law as plain numbers; the shape of a table without rows is said, too."""
    return {k: {"shape": list(v.shape), "values": _listed(v)} for k, v in law.arrays().items()}


def _listed(values: NDArray[np.float64]) -> list[float]:
    numbers: list[float] = values.ravel().tolist()
    return numbers


def _law(content: Mapping[str, Any]) -> ForceLaw:
    return ForceLaw.of(
        {k: np.array(v["values"], dtype=np.float64).reshape(v["shape"]) for k, v in content.items()}
    )
