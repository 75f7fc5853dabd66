"""The compensator beside a flying aircraft says what it says of the recording."""

import socket
from contextlib import closing
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from cli_rig import run
from learning_rigs.compensator_rig import compensator, exported, tiny
from sample_logs import flown_table

from learning.data.flights import residual_flight, restart_before_s
from learning.preset import Protocol
from twin.logs import Flight, read_flight
from twin.logs.mavlink.frames import Message, parser
from twin.residuals.aligned import AlignedFlight
from twin.vehicle_file import load_vehicle
from uavtwin.cli.live import _print_model
from uavtwin.compensators.running import Correction, RunningCompensator, compiled_compensator
from uavtwin.live.following import Publisher
from uavtwin.live.recording import Recording
from uavtwin.live.status import ModelStatus
from uavtwin.live.worker import Batch, Worker
from uavtwin.sockets import Address

VEHICLE = "copter_default"


def model(folder: Path, protocol: Protocol) -> Path:
    made = compensator(tiny(), protocol, horizon=5, vehicle=VEHICLE, envelope=1e4)
    return exported(made, folder / "model")


def flown_beside(running: RunningCompensator, folder: Path) -> list[Correction]:
    """Hand a flight over as `live` does; returns what was said."""
    said: list[Correction] = []
    look = running.update

    def noted(
        flight: Flight, until_s: float, aligned: AlignedFlight | None = None
    ) -> Correction | None:
        found = look(flight, until_s, aligned)
        said.extend([] if found is None else [found])
        return found

    running.update = noted  # type: ignore[method-assign]
    recording = Recording(folder, 4)
    worker = Worker(load_vehicle(VEHICLE), recording, 0.5, compensator=running)
    table = flown_table().iloc[:900]
    for first in range(0, len(table), 10):
        part = table.iloc[first : first + 10]
        worker.add(Batch({str(c): part[c].to_numpy() for c in part}, {}, ()))
    worker.close()
    recording.close()
    assert worker.model is running.status
    return said


@pytest.mark.slow
@pytest.mark.parametrize("protocol", ["track", "free"])
def test_live_as_offline(protocol: Protocol, tmp_path: Path) -> None:
    """By the recording: each sample's correction, score and envelope."""
    vehicle = load_vehicle(VEHICLE)
    with compiled_compensator(model(tmp_path, protocol)) as compiled:
        network = compiled.network
        with closing(RunningCompensator(compiled.fmu, network, vehicle)) as running:
            said = flown_beside(running, tmp_path / "rec")
        assert len(said) > 2
        recorded = read_flight(tmp_path / "rec" / "flight.parquet")
        restart_s = restart_before_s(protocol, network.horizon, network.rate_hz)
        whole = residual_flight(recorded, vehicle, network.rate_hz, restart_s)
        offline = compiled.run(whole)
    t_s = np.concatenate([s.t_s for s in said])
    rows = np.round((t_s - whole.t_s[0]) * network.rate_hz).astype(int)
    np.testing.assert_allclose(whole.t_s[rows], t_s, atol=1e-9)
    assert np.all(np.diff(rows) == 1) and len(rows) > 400
    first = next(a for a, b in whole.spans if a <= rows[0] < b)
    assert rows[0] == first, "from the beginning of the flight"
    scale = np.array(network.uncorrected_rms)
    for name in ("correction", "anomaly", "inside"):
        live = np.concatenate([getattr(s, name) for s in said])
        there = getattr(offline, name)[rows]
        if name == "correction":
            live, there = live / scale, there / scale
        np.testing.assert_allclose(live, there, rtol=1e-4, atol=1e-4, err_msg=name)
    assert running.horizon_s == (0.05 if protocol == "track" else np.inf)
    status = running.status
    assert status.until_s == t_s[-1]
    np.testing.assert_equal(status.anomaly, said[-1].anomaly.max())
    for score in (status.anomaly, status.unusual):
        assert np.isfinite(score) == (protocol == "track")
    fresh = np.concatenate([s.residual for s in said])[:, network.channels.index("acc_z")]
    assert status.rms["acc_z"][0] == pytest.approx(np.sqrt(np.nanmean(fresh**2)))


def test_a_compensator_without_score_or_residuals_claims_none(
    capsys: pytest.CaptureFixture[str],
) -> None:
    _print_model(ModelStatus(np.inf, inside=0.9), {})
    assert capsys.readouterr().out == (
        "compensator, which sees no residuals: inside its training in 90%\n"
    )


def test_the_score_is_a_number_on_the_ground_station() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as station:
        station.bind(("127.0.0.1", 0))
        station.settimeout(1.0)
        publisher = Publisher(Address("127.0.0.1", station.getsockname()[1]), 4)
        publisher.anomaly(1.25)
        publisher.tick(1)
        publisher.close()
        reader, heard = parser(), list[Message]()
        while len(heard) < 2:
            heard += reader.parse_buffer(station.recv(1000)) or ()
    assert heard[1].get_type() == "NAMED_VALUE_FLOAT"
    assert (heard[1].name, heard[1].value) == ("anomaly", 1.25)


@pytest.mark.slow
def test_a_compensator_of_another_vehicle_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    where = model(tmp_path, "track")
    code, _, err = run(capsys, "live", "--vehicle", "feisi_x150", "--model", where)
    assert code == 2 and "corrects the twin of copter_default" in err.replace("\n", " ")


@pytest.mark.slow
def test_nothing_is_said_on_the_ground(tmp_path: Path) -> None:
    vehicle = load_vehicle(VEHICLE)
    with (
        compiled_compensator(model(tmp_path, "track")) as compiled,
        closing(RunningCompensator(compiled.fmu, compiled.network, vehicle)) as running,
    ):
        table = pd.DataFrame(flown_table().iloc[:300])
        table[[c for c in table if str(c).startswith("cmd_")]] = 0.0
        assert running.update(Flight("standing", table), 2.9) is None
        assert running.status.rms == {}
