"""`why --since`: what has changed since a calibration, in newtons and kilograms."""

from dataclasses import replace

import numpy as np
import pytest
from cli_rig import run

from twin.effects import EFFECTS
from twin.explain.balance import CAUSES, trim_of
from twin.explain.model.model import model_of
from twin.logs import write_flight
from twin.vehicle import Calibration, Vehicle
from twin.vehicle_file import load_vehicle
from twin.why.diagnose import diagnose
from twin.why.records import Diagnosis
from uavtwin.demo.in_flight import damaged_flight

COPTER = load_vehicle("copter_default")
pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def calibrated() -> Vehicle:
    """The copter with the balance of three sound flights, as `calibrate` writes it."""
    flights = [damaged_flight(COPTER, 90.0, 0.0, 20.0, seed).between(4, 20) for seed in (1, 2, 3)]
    effects = [EFFECTS[name] for name in (*CAUSES, "steady_wind")]
    trim = trim_of(model_of(flights, COPTER, effects), slopes=False)
    assert trim is not None
    none = np.zeros((0, 0))
    names = tuple(f.name for f in flights)
    return replace(COPTER, calibration=Calibration(names, (), none, {}, {}, {}, *trim.by_name()))


def answer(calibrated: Vehicle, flies: Vehicle, begins_s: float, loss: float) -> Diagnosis:
    return diagnose(damaged_flight(flies, begins_s, loss, 24.0, seed=7), since=calibrated)


def test_a_sound_flight_has_changed_in_nothing(calibrated: Vehicle) -> None:
    found = answer(calibrated, COPTER, 90.0, 0.0)
    assert found.verdict == "nothing_found" and not found.events
    least = {v.cause: v.smallest_detectable for v in found.not_visible}
    assert least["payload_cg"].unit == "kg" and 0.05 < (least["payload_cg"].value or 0.0) < 0.5
    assert any("calibration of copter_default on 3 flights" in note for note in found.notes)


def test_a_rotor_that_was_weak_from_the_start(calibrated: Vehicle) -> None:
    """Named, or one of two causes of which it is the more probable one."""
    found = answer(calibrated, COPTER, 0.5, 0.2)
    said = found.one_of_causes or found.events
    assert found.verdict == "found"
    assert (said[0].cause, said[0].rotor) == ("rotor_efficiency_loss", (3,))


def test_a_load_has_its_mass(calibrated: Vehicle) -> None:
    heavy = replace(COPTER, mass_kg=1.2 * COPTER.mass_kg)
    (event,) = answer(calibrated, heavy, 90.0, 0.0).events
    assert event.cause == "payload_cg" and event.severity is not None
    assert event.severity.unit == "kg" and event.severity.quantity == "added_mass"
    assert event.severity.value == pytest.approx(0.2 * COPTER.mass_kg, rel=0.25)
    assert "at the calibration" in event.text


def test_a_sudden_loss_is_in_newtons_and_no_change_since_then(calibrated: Vehicle) -> None:
    found = diagnose(damaged_flight(COPTER, 20.0, 0.3, 26.0, seed=7), since=calibrated)
    (event,) = found.events
    assert not found.one_of_causes and event.rotor == (3,)
    assert event.severity is not None and event.severity.unit == "N"
    hover_n = COPTER.mass_kg * 9.80665 / COPTER.rotors.count
    assert event.severity.value == pytest.approx(0.3 * hover_n, rel=0.25)


def test_a_file_without_calibration_says_so(
    tmp_path_factory: pytest.TempPathFactory, capsys: pytest.CaptureFixture[str]
) -> None:
    log = tmp_path_factory.mktemp("since") / "flight.parquet"
    write_flight(damaged_flight(COPTER, 90.0, 0.0, 18.0), log)
    code, out, _ = run(capsys, "why", str(log), "--since", "copter_default")
    assert code == 0 and "holds no calibration" in out
    code, _, err = run(
        capsys, "why", str(log), "--since", "copter_default", "--reference", str(log)
    )
    assert code == 2 and "normal flights, or since" in err
