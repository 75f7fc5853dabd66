"""Driven twins that follow a flight and then fly alone."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cosim.whole_twin import fused_model
from fmus import build
from twin.flight.assembly import driven_twin
from twin.physics.observer import LEARNED
from twin.residuals.teacher_forced import choose_drive
from twin.vehicle_file import load_vehicle
from uavtwin.demo.flights import fly
from uavtwin.force.open_loop import QUANTITIES, Replay

COPTER = load_vehicle("copter_default")
ABOVE_M = 0.3
SLOW = {"airframe.disturbance.enabled": 1.0} | {
    f"airframe.disturbance.lag.{name}": 1.0 for name, _, _ in LEARNED
}


@pytest.mark.slow
def test_what_carries_an_aircraft_on_the_ground_is_no_disturbance(tmp_path: Path) -> None:
    """A log counts its heights from somewhere; on its ground the twin would fall.

    Learned in a second and begun on the ground, half a weight would be left in the first second of
    flight.
    """
    flight = fly(COPTER, COPTER, seed=1)
    table = flight.table.copy()
    table["pos_z"] -= ABOVE_M
    lifted = replace(flight, table=table)
    twin = driven_twin(COPTER, choose_drive(lifted, COPTER), ())
    fmu = build(fused_model(twin, COPTER.name), tmp_path / "driven.fmu")
    replay = Replay(lifted, COPTER, (0.5,))
    rms = {
        name: replay.through(fmu, starts).rms[0]
        for name, starts in (("alone", {}), ("observed", SLOW))
    }
    velocity = [name for name, _ in QUANTITIES].index("velocity")
    assert rms["observed"][velocity, 2] < rms["alone"][velocity, 2] + 0.02
    assert np.isfinite(rms["observed"]).all()
