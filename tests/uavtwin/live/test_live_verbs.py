"""`uavtwin live` and `uavtwin replay` as they are called."""

import json
from pathlib import Path

import pytest
from cli_rig import run
from sample_logs import flown_table

from twin.logs import Flight, write_flight
from twin.logs.mavlink.decoder import MavlinkDecoder
from uavtwin.live.replay import Faults, FaultyLink, played


@pytest.fixture
def log(tmp_path: Path) -> Path:
    path = tmp_path / "flown.parquet"
    write_flight(Flight("flown", flown_table().iloc[:200]), path)
    return path


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--to", "tcp:127.0.0.1:5760"), "write udpout:HOST:PORT"),
        (("--to", "udpout:127.0.0.1:99999"), "write udpout:HOST:PORT"),
        (("--speed", "fast"), "a number, or max"),
        (("--speed", "-1"), "more than 0"),
        (("--speed", "max", "--loss", "0.1"), "without loss or jitter"),
        (("--drift", "20m"), "no unit of the kind of"),
        (("--loss", "5"), "a share of 0 to below 1"),
        (("--system", "0"), "1 to 255"),
        (("--begin", "50"), "nothing between --begin and --end"),
    ],
)
def test_replay_used_wrongly(
    log: Path, arguments: tuple[str, ...], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    code, _, err = run(capsys, "replay", log, *arguments)
    assert code == 2 and said in err.replace("\n", " ")


def test_replay_into_the_void(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Nobody has to listen, unless in step."""
    code, out, _ = run(
        capsys, "replay", log, "--to", "udpout:127.0.0.1:9", "--speed", "20", "--json"
    )
    report = json.loads(out)
    assert code == 0 and report["seconds"] == pytest.approx(1.99) and report["messages"] > 600


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--listen", "udpout:127.0.0.1:14550"), "write udpin:HOST:PORT"),
        (("--listen", "udpin:192.0.2.1:14550"), "cannot be listened at"),
        (("--horizon", "0.0005"), "a multiple of 1 ms"),
        (("--hold", "-1"), "0 to 10 s"),
        (("--observer", "0"), "0.02 to 60 s"),
        (("--publish", "udpin:127.0.0.1:1"), "write udpout:HOST:PORT"),
        (("--token", "correct horse"), "there is no page"),
    ],
)
def test_live_used_wrongly(
    arguments: tuple[str, ...], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    code, _, err = run(capsys, "live", "--vehicle", "copter_default", *arguments)
    assert code == 2 and said in err.replace("\n", " ")


@pytest.mark.slow
def test_nothing_is_heard(capsys: pytest.CaptureFixture[str]) -> None:
    code, out, err = run(
        capsys,
        *("live", "--vehicle", "copter_default", "--listen", "udpin:127.0.0.1:47123"),
        *("--duration", "0.3", "--json"),
    )
    report = json.loads(out)
    assert (
        code == 1
        and report["link"]["system"] is None
        and "no HIGHRES_IMU" in report["missing"]["acc"]
    )
    assert "nothing heard yet" in err


def test_what_is_played_is_the_flight() -> None:
    """Every sample once, in order of time, with a heartbeat each second."""
    flight, decoder = Flight("flown", flown_table().iloc[:350]), MavlinkDecoder()
    batches = list(played(flight))
    assert [t for t, _ in batches] == sorted(t for t, _ in batches)
    kinds = [m.get_type() for _, several in batches for m in several]
    assert kinds.count("HEARTBEAT") == 4 and kinds[0] == "HEARTBEAT"
    assert kinds.count("HIGHRES_IMU") == 350
    assert not decoder.kinds


def test_faults_are_drawn_from_their_seed() -> None:
    def sent(seed: int) -> tuple[int, list[bytes]]:
        link = FaultyLink(Faults(loss=0.1, jitter_s=0.02, seed=seed))
        for k in range(2000):
            link.send(0.001 * k, bytes([k % 256, k // 256]))
        return link.lost, link.due(10.0)

    assert sent(1) == sent(1) != sent(2)
    lost, came = sent(1)
    assert 150 < lost < 250 and len(came) == 2000 - lost and came != sorted(came)
