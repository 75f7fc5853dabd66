"""What every training checks about its flights, and how they are written down."""

import hashlib
import json
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from twin.errors import ModelError

from ..data.flights import ResidualFlight
from ..data.scaling import in_spans
from ..model.family import PresetT, TrainingTask
from ..model.info import ModelInfo


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
    for array in (*arrays, flight.fresh, flight.phase.astype(np.int64)):
        digest.update(np.ascontiguousarray(array).tobytes())
    samples = int(in_spans(flight).sum())
    return {
        "name": flight.name,
        "sha256": digest.hexdigest(),
        "log_sha256": flight.log_sha256,
        "samples": samples,
        "seconds": samples / flight.rate_hz,
    }


def hash_training(content: object) -> str:
    """One hash of all that decides a model's numbers; JSON content."""
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def describe_training(
    family: str, flights: Sequence[ResidualFlight], preset: PresetT, task: TrainingTask
) -> ModelInfo[PresetT]:
    """What a model of these flights says of itself, for a family in closed form.

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
        training=hash_training(decides),
    )
