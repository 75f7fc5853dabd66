"""A minute of a flying twin with its compensator: C in the fused FMU = onnxruntime = torch."""

from pathlib import Path

import numpy as np
import onnx
import pytest
from learning_rigs.compensator_rig import compensator, exported, tiny
from numpy.typing import NDArray

from cosim.master import Master
from cosim.system import System
from cosim.whole_twin import fused_model
from fmus import build
from fmus.compensator import FILE, compensator_model
from learning.data.channels import CHANNELS
from learning.export.write import flight_of, streamed
from twin.flight.assembly import flying_twin
from twin.vehicle_file import load_vehicle

VEHICLE, STEP_S, SAMPLE_S = "crazyflie", 1e-3, 0.01
TOLERANCE = 1e-5
"""Of the spread."""


@pytest.mark.long
def test_a_minute_in_the_loop(tmp_path: Path) -> None:
    """Fed with what the fused twin itself made; commands are those of the step before."""
    model = compensator(tiny(encoder_units=(10, 7)), "free", vehicle=VEHICLE, envelope=1e4)
    network = compensator_model(exported(model, tmp_path / "model"))
    assembly = flying_twin(load_vehicle(VEHICLE), "tour")
    fmu = build(fused_model(assembly, VEHICLE, network), tmp_path / "twin.fmu")
    with Master(System({"twin": fmu})) as master:
        columns = {n.removeprefix("twin."): i for i, n in enumerate(master.record_names)}
        master.initialize()
        values = master.run(60.0, STEP_S).values
    every = round(SAMPLE_S / STEP_S)

    def said(*names: str, earlier: int = 0) -> NDArray[np.float64]:
        """Signals at the samples, shape (samples, len(names))."""
        rows = np.arange(every, len(values), every) - earlier
        return values[rows][:, [columns[n] for n in names]]

    correction, corrected, spread = (
        said(*(f"compensator.{kind}.{c}" for c in CHANNELS))
        for kind in ("correction", "corrected", "spread")
    )
    unknown = np.full_like(correction, np.nan)
    seen = {
        "virtual": corrected - correction,
        "command": said(*(f"controller.cmd_{i}" for i in range(1, 5)), earlier=1),
        "phase": said("mission.phase", earlier=1),
        "measured": unknown,
        "valid": np.zeros_like(unknown),
    }
    rows = {name: each.astype(np.float32) for name, each in seen.items()}
    theirs = streamed(onnx.load(tmp_path / "model" / FILE), rows)["correction"]
    ours = model.run(flight_of(rows, 1 / SAMPLE_S)).correction
    assert len(ours) == 6000
    assert (np.ptp(correction, axis=0) > 0.1 * spread.mean(axis=0)).all()
    for other in (theirs, ours):
        assert np.max(np.abs(correction - other) / spread) < TOLERANCE
