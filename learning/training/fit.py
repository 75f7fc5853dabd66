"""Training of any family: the checks before, the folder after."""

from collections.abc import Sequence
from pathlib import Path

from ..data.flights import ResidualFlight
from ..data.sequences import check_protocol
from ..model.family import FamilyPreset, Progress, TrainedModel, TrainingTask, silent
from ..model.folder import save
from ..model.registry import FamilyRow, check_preset
from ..threads import one_thread
from .inputs import check_flights


def fit_model(
    flights: Sequence[ResidualFlight],
    row: FamilyRow,
    preset: FamilyPreset,
    task: TrainingTask,
    folder: Path,
    progress: Progress = silent,
) -> TrainedModel:
    """Train a model of any family on all flights and write its folder.

    Args:
        flights: At one rate and with one number of commands.
        row: The family.
        preset: One of the family's, or a changed one.
        task: Protocol, horizon, seed, vehicle.
        folder: Made if it does not exist.
        progress: Called as the work goes on, and at its end.

    Raises:
        ModelError: The flights do not fit together, the preset is not for this protocol, or the
            folder belongs to another training.
    """
    check_flights(flights)
    check_protocol(task.protocol, task.horizon)
    check_preset(row, preset, task.protocol)
    folder.mkdir(parents=True, exist_ok=True)
    with one_thread():
        model: TrainedModel = row.load().fit(flights, preset, task, folder, progress)
    save(model, folder)
    progress(1.0, 0.0)
    return model
