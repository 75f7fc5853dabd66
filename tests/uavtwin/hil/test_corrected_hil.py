"""What was learned is in what an autopilot is told."""

from pathlib import Path

import numpy as np
import pytest
from learning_rigs.compensator_rig import compensator, exported, tiny

from twin.errors import TwinError
from twin.vehicle.file import load_vehicle
from uavtwin.exports.parts import compensator as read_compensator
from uavtwin.hil.flying import flying_twin_of

VEHICLE = "copter_default"
COMMANDS = [0.7, 0.72, 0.7, 0.72]


@pytest.mark.slow
def test_a_compensator_corrects_the_readings_and_not_the_motion(tmp_path: Path) -> None:
    model = compensator(tiny(encoder_units=(10, 7)), "free", vehicle=VEHICLE, envelope=1e4)
    network = read_compensator(exported(model, tmp_path / "model"))
    vehicle, flown = load_vehicle(VEHICLE), {}
    for name, given in (("plain", None), ("corrected", network)):
        (tmp_path / name).mkdir()
        with flying_twin_of(vehicle, tmp_path / name, compensator=given) as twin:
            for k in range(1, 251):
                flown[name] = twin.fly(COMMANDS, 0.004 * k)
            if given is not None:
                correction = [twin._slave.get(f"compensator.correction.acc_{a}") for a in "xyz"]
    for signal in ("pos", "vel", "q", "omega", "force"):
        assert flown["corrected"][signal] == flown["plain"][signal]
    off = np.subtract(flown["corrected"]["acc"], flown["plain"]["acc"])
    assert np.abs(off).max() > 1e-3
    np.testing.assert_allclose(off, correction, rtol=0, atol=16 * 2.0**-24)  # sums in float32


def test_a_compensator_that_sees_measurements_has_none_here(tmp_path: Path) -> None:
    model = compensator(tiny(), "track", vehicle=VEHICLE)
    network = read_compensator(exported(model, tmp_path / "model"))
    with pytest.raises(TwinError, match=r"protocol track.*--protocol free, or --protocol force"):
        flying_twin_of(load_vehicle(VEHICLE), tmp_path, compensator=network)
