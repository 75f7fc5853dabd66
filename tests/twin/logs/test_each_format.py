"""Each log format keeps its word, on its sample: told by its bytes, SI and FRD, no surprise."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from log_rigs.ros_rig import needs_rosbags
from sample_logs import SAMPLES

from twin.errors import TwinError
from twin.logs import read_flight
from twin.logs.formats import FORMATS, HEAD

NAMES = [
    pytest.param(f.name, marks=[needs_rosbags] if "rosbags" in f.packages else []) for f in FORMATS
]


@pytest.mark.parametrize("name", NAMES)
def test_a_sample_is_recognised_and_read(name: str, tmp_path: Path) -> None:
    """Whatever it is called: at rest, SI, FRD."""
    path = tmp_path / "flight.bin"
    path.write_bytes(SAMPLES[name]())
    claimed = [f.name for f in FORMATS if f.signature.matches(path.read_bytes()[:HEAD])]
    assert claimed == [name]
    flight = read_flight(path)
    assert flight.facts["format"] == name and next(iter(flight.facts)) == "format"
    assert flight.source == path and flight.name == "flight"
    t, acc = flight.signal(["acc_x", "acc_y", "acc_z"])
    assert np.all(np.diff(t) > 0) and t[0] >= 0
    np.testing.assert_allclose(acc - (0.0, 0.0, -9.80665), 0.0, atol=1e-3)
    _, gyro = flight.signal(["gyro_x", "gyro_y", "gyro_z"])
    np.testing.assert_allclose(gyro, 0.0, atol=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
@settings(max_examples=60)
@given(share=st.floats(0, 1), garbage=st.binary(max_size=8))
def test_a_damaged_file_raises_nothing_but_a_log_error(
    name: str, share: float, garbage: bytes, tmp_path_factory: pytest.TempPathFactory
) -> None:
    """Cut anywhere, with something else behind."""
    blob = SAMPLES[name]()
    path = tmp_path_factory.mktemp("cut") / "log"
    path.write_bytes(blob[: int(share * len(blob))] + garbage)
    try:
        flight = read_flight(path)
    except TwinError as error:
        assert len(str(error)) > 20
    else:
        assert np.all(np.diff(flight.table["time"]) > 0)
