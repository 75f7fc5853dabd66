"""What was learned is in what an autopilot is told."""

from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from learning_rigs.compensator_rig import compensator, exported, tiny

from learning.force.model import ForceModel, save_force
from twin.errors import TwinError
from twin.physics.residual_force import FEATURES, INPUTS, OUTPUTS, ForceLaw
from twin.vehicle_file import load_vehicle
from uavtwin.exports.parts import LearnedForce
from uavtwin.exports.parts import compensator as read_compensator
from uavtwin.hil.flying import flying_twin_of
from uavtwin.run import run_plan, with_model
from uavtwin.simulation import Scenario

VEHICLE = "copter_default"
COMMANDS = [0.7, 0.72, 0.7, 0.72]


@pytest.mark.slow
def test_a_compensator_corrects_the_readings_and_not_the_motion(tmp_path: Path) -> None:
    model = compensator(tiny(encoder_units=(10, 7)), "free", vehicle=VEHICLE, envelope=1e4)
    network = read_compensator(exported(model, tmp_path / "model"))
    vehicle, flown = load_vehicle(VEHICLE), {}
    for name, given in (("plain", None), ("corrected", network)):
        (tmp_path / name).mkdir()
        with closing(flying_twin_of(vehicle, tmp_path / name, compensator=given)) as twin:
            for k in range(1, 251):
                flown[name] = twin.fly(COMMANDS, 0.004 * k)
            if given is not None:
                correction = [twin._slave.get(f"compensator.correction.acc_{a}") for a in "xyz"]
    for signal in ("pos", "vel", "q", "omega", "force"):
        assert flown["corrected"][signal] == flown["plain"][signal]
    off = np.subtract(flown["corrected"]["acc"], flown["plain"]["acc"])
    assert np.abs(off).max() > 1e-3
    np.testing.assert_allclose(off, correction, rtol=0, atol=16 * 2.0**-24)  # sums in float32


@pytest.mark.slow
def test_a_compensator_that_sees_measurements_has_none_here(tmp_path: Path) -> None:
    model = compensator(tiny(), "track", vehicle=VEHICLE)
    network = read_compensator(exported(model, tmp_path / "model"))
    with pytest.raises(TwinError, match=r"protocol track.*--protocol free, or --protocol force"):
        flying_twin_of(load_vehicle(VEHICLE), tmp_path, compensator=network)


PUSH_M_S2 = 0.5


def pushed_forward(mass_kg: float) -> ForceModel:
    """A law that pushes forward by as much, wherever it is."""
    n = len(INPUTS)
    linear = np.zeros((len(OUTPUTS), len(FEATURES)))
    linear[0, FEATURES.index("one")] = PUSH_M_S2
    law = ForceLaw(
        linear=linear,
        centre=np.zeros(n),
        scale=np.ones(n),
        whitening=np.eye(n),
        reach=1e6,
        most=np.full(len(OUTPUTS), 1e3),
        units=mass_kg * np.eye(len(OUTPUTS)),
    )
    return ForceModel(law=law, flights=(), vehicle=VEHICLE, vehicle_sha256="", seed=0, ridge=1.0)


@pytest.mark.slow
def test_a_learned_force_moves_the_aircraft(tmp_path: Path) -> None:
    """Half a metre per second squared forward, in specific force and so in speed."""
    vehicle, flown = load_vehicle(VEHICLE), {}
    force = LearnedForce(pushed_forward(vehicle.mass_kg))
    for name, given in (("plain", None), ("pushed", force)):
        (tmp_path / name).mkdir()
        with closing(flying_twin_of(vehicle, tmp_path / name, force=given)) as twin:
            for k in range(1, 126):
                flown[name] = twin.fly([0.9] * 4, 0.004 * k)
    assert flown["plain"]["pos"][2] < -1.0, "it has left the ground"
    more = np.subtract(flown["pushed"]["force"], flown["plain"]["force"])
    # The ground is left a trifle sooner or later, and the air is thinner higher up.
    np.testing.assert_allclose(more, (PUSH_M_S2, 0.0, 0.0), atol=1e-4)
    assert flown["plain"]["vel"][0] == pytest.approx(0.0, abs=1e-9)
    assert 0.1 < flown["pushed"]["vel"][0] < 0.5 * PUSH_M_S2


def flown_with(folder: Path, fused: bool = False) -> dict[str, np.ndarray[Any, Any]]:
    """Outputs of two seconds of a hover with what a folder holds."""
    plan = with_model(Scenario("hover", load_vehicle(VEHICLE), fused=fused), folder)
    recording = run_plan(plan, stop_s=2.0).recording
    names = [n.removeprefix("twin.") for n in recording.names]
    return dict(zip(names, recording.values.T, strict=True))


@pytest.mark.slow
@pytest.mark.parametrize("fused", [False, True], ids=["parts", "fused"])
def test_a_scenario_flies_with_a_learned_force(tmp_path: Path, fused: bool) -> None:
    """Rotors push along z alone: once it has left the ground, what is forward was learned."""
    vehicle = load_vehicle(VEHICLE)
    save_force(pushed_forward(vehicle.mass_kg), tmp_path)
    flown = flown_with(tmp_path, fused)
    assert flown["airframe.specific_force_x"][-50:] == pytest.approx(PUSH_M_S2, abs=0.05)


@pytest.mark.slow
def test_a_scenario_flies_with_a_compensator(tmp_path: Path) -> None:
    model = compensator(tiny(encoder_units=(10, 7)), "free", vehicle=VEHICLE, envelope=1e4)
    flown = flown_with(exported(model, tmp_path / "model"))
    read, corrected = flown["imu.acc_x"], flown["compensator.corrected.acc_x"]
    correction = flown["compensator.correction.acc_x"]
    assert np.abs(correction).max() > 1e-3
    late = slice(1, None)  # a network has its inputs a step late
    assert corrected[late] - read[late] == pytest.approx(correction[late], abs=0.1)


def test_a_scenario_flies_with_both_that_a_folder_holds(tmp_path: Path) -> None:
    folder = exported(compensator(tiny(), "free", vehicle=VEHICLE), tmp_path / "model")
    (folder / "model.json").write_text("{}")  # as `train` writes beside a compensator
    save_force(pushed_forward(load_vehicle(VEHICLE).mass_kg), folder)
    plan = with_model(Scenario("hover", load_vehicle(VEHICLE)), folder)
    assert plan.compensator is not None and plan.law is not None
    assert plan.law.linear[0, FEATURES.index("one")] == PUSH_M_S2


def test_a_model_of_another_vehicle_flies_no_scenario(tmp_path: Path) -> None:
    save_force(replace(pushed_forward(1.0), vehicle="another"), tmp_path)
    with pytest.raises(TwinError, match="corrects the twin of another"):
        with_model(Scenario("hover"), tmp_path)
    with pytest.raises(TwinError, match="brings its own parts"):
        with_model(Scenario(tmp_path / "a.ssp"), tmp_path)
