"""Logs that are dropped, and what comes of them: real jobs in real processes."""

import io
import json
import threading
import zipfile
from collections.abc import Iterator
from pathlib import Path

import pandas as pd
import pytest
from log_rigs.ros_rig import OUTPUTS, bag, mavros_bag, needs_rosbags
from sample_logs import flown_table
from serve_rigs.sites import Asked, site, sound_log
from websockets.sync.client import connect

from uavtwin.demo import in_flight
from uavtwin.serve.schedule import QUICK_SHARE, Limits
from uavtwin.serve.store import OF_VEHICLE
from uavtwin.serve.work import KINDS, LONG, MOST_LOGS, QUICK, LogWork

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def asked(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Asked]:
    with site(tmp_path_factory.mktemp("store"), workers=1) as opened:
        yield opened


@pytest.fixture(scope="module")
def flight(asked: Asked, tmp_path_factory: pytest.TempPathFactory) -> str:
    """A flight that is read and compared."""
    log = sound_log(tmp_path_factory.mktemp("logs"))
    found = uploaded(asked, log)
    asked.wait(f"/flights/{found}", "open-why")
    return found


def uploaded(asked: Asked, log: Path) -> str:
    status, text, _ = asked.ask(f"/upload/{log.name}", "PUT", log.read_bytes())
    assert status in (200, 201)
    return str(json.loads(text)["flight"])


def test_check_then_why_need_no_further_word(asked: Asked, flight: str) -> None:
    page = asked.ask(f"/flights/{flight}")[1]
    assert "multirotor" in page or "4 rotors" in page
    assert "20 s, " in asked.ask("/")[1]
    report = asked.ask(f"/flights/{flight}/why")[1]
    assert "What this log could not have shown" in report
    assert f'<a href="/flights/{flight}">sound.parquet</a>' in report
    assert asked.ask(f"/flights/{flight}/files/flight.parquet")[0] == 200
    assert json.loads(asked.ask(f"/flights/{flight}/files/why.json")[1])["flight"] == "sound"


def test_a_hostile_log_is_a_row_that_says_why(asked: Asked, tmp_path: Path) -> None:
    log = tmp_path / "hostile.ulg"
    log.write_bytes(b"ULog\x01\x12\x35\x01" + bytes(range(256)) * 20)
    found = uploaded(asked, log)
    page = asked.wait(f"/flights/{found}", 'class="verdict unreadable"')
    assert "cannot be read as a flight" in page


def test_a_zip_of_logs_becomes_a_row_each(asked: Asked, flight: str, tmp_path: Path) -> None:
    packed = tmp_path / "day.zip"
    with zipfile.ZipFile(packed, "w") as archive:
        for name in ("one.csv", "other.csv"):
            archive.write(sound_log(tmp_path, name, 3.0), f"../../{name}")
        archive.writestr("readme.txt", "no log")
    found = uploaded(asked, packed)
    asked.wait("/", r"one\.csv.*other\.csv|other\.csv.*one\.csv")
    assert asked.ask(f"/flights/{found}")[0] == 404
    assert "day.zip" not in asked.ask("/")[1]


def test_a_vehicle_file_that_is_dropped_can_be_chosen(
    asked: Asked, flight: str, tmp_path: Path
) -> None:
    file = tmp_path / "mine.toml"
    file.write_text((Path("twin/vehicle/built_in/copter_default.toml")).read_text())
    found = uploaded(asked, file)
    asked.wait(f"/flights/{flight}", r"<option>mine</option>")
    assert asked.ask(f"/flights/{found}")[0] == 404
    wrong = tmp_path / "wrong.toml"
    wrong.write_text("mass = 'heavy'")
    assert "wrong.toml" in asked.wait(f"/flights/{uploaded(asked, wrong)}", "unreadable")


@needs_rosbags
def test_a_mapping_file_that_is_dropped_names_topics_of_its_bag(
    asked: Asked, tmp_path: Path
) -> None:
    """Before its bag, then another one after it."""
    table = flown_table().iloc[:1000]
    other = OUTPUTS.replace("/mavros/rc/out", "/mavros/none")
    status, text, _ = asked.ask("/upload/day.topics.toml", "PUT", other.encode())
    assert (status, json.loads(text)["note"]) == (201, "waits for a bag of its name")
    status, text, _ = asked.ask("/upload/day.mcap", "PUT", bag(mavros_bag(table)))
    flight = json.loads(text)["flight"]
    assert "/mavros/none" in asked.wait(f"/flights/{flight}", r'class="verdict unreadable"')
    status, text, _ = asked.ask("/upload/day.topics.toml", "PUT", OUTPUTS.encode())
    assert json.loads(text)["flights"] == [flight]
    asked.wait(f"/flights/{flight}", "open-why")
    read = pd.read_parquet(asked.store / "flights" / flight / "flight.parquet")
    assert {"cmd_1", "cmd_4"} <= {*read}
    assert "topics" not in asked.ask("/")[1].partition("<tbody")[2], "a mapping is no flight"


def test_gap_with_a_chosen_vehicle_and_two_flights_over_each_other(
    asked: Asked, flight: str, tmp_path: Path
) -> None:
    asked.ask(f"/flights/{flight}/vehicle", "POST", b"vehicle=copter_default")
    asked.wait(f"/flights/{flight}", "open-gap")
    assert "acc_z" in asked.ask(f"/flights/{flight}/gap")[1]
    other = uploaded(asked, sound_log(tmp_path, "short.csv", 8.0))
    page = asked.wait(f"/flights/{flight}/compare/{other}", "Two flights over each other")
    assert "Body rates" in page and "Neither log says which parameters differ" in page


def test_a_draft_that_lacks_something_says_what(asked: Asked, flight: str) -> None:
    asked.ask(f"/flights/{flight}/draft", "POST", b"mass_kg=1.3")
    assert "wheelbase" in asked.wait(f"/flights/{flight}", r"<b>Failed:</b>.*Try again")


def test_mcap_is_made_when_asked_for(asked: Asked, flight: str) -> None:
    assert asked.ask(f"/flights/{flight}/files/flight.mcap")[0] == 404
    asked.ask(f"/flights/{flight}/jobs/mcap", "POST")
    asked.wait(f"/flights/{flight}", "open-mcap")
    assert asked.ask(f"/flights/{flight}/files/flight.mcap")[1].startswith(
        "\N{REPLACEMENT CHARACTER}MCAP"
    )


def test_a_log_in_an_archive_has_the_limit_of_any(tmp_path: Path) -> None:
    packed = tmp_path / "bomb.zip"
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
        for k in range(2):
            archive.writestr(f"{k}.csv", "time,acc_z\n" + "0.0,0.0\n" * 300_000)
    job = {"kind": "check", "log": str(packed), "folder": str(tmp_path), "incoming": str(tmp_path)}
    assert "--size-limit" in LogWork(1_000_000).do(job)["error"]


def test_an_archive_of_many_small_logs_has_a_limit_too(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("twin.logs.read._ALWAYS", 1_000_000)
    packed = tmp_path / "bomb.zip"
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
        for k in range(5):
            archive.writestr(f"{k}.csv", "time,acc_z\n" + "0.0,0.0\n" * 100_000)
    said = LogWork(1_000_000).do(checked(packed))["error"]
    assert said.startswith("bomb.zip: unpacks to over 1") and "100 times its size" in said


def test_a_damaged_log_of_an_archive_is_named(tmp_path: Path) -> None:
    packed = tmp_path / "day.zip"
    with zipfile.ZipFile(packed, "w") as archive:
        for name in ("one.csv", "other.csv"):
            archive.writestr(name, "time,acc_z\n" + "0.0,0.0\n" * 10_000)
    content = packed.read_bytes()
    at = content.index(b"other.csv") + 70_000
    packed.write_bytes(content[:at] + b"?" + content[at + 1 :])
    said = LogWork(1_000_000).do(checked(packed))["error"]
    assert said.startswith("day.zip: other.csv cannot be unpacked (Bad CRC-32")
    assert said.endswith("Copy or download the archive again.")
    (tmp_path / "full").mkdir()
    full = {**checked(packed), "incoming": str(tmp_path / "full" / "not there" / "x")}
    assert LogWork(1_000_000).do(full)["error"].endswith("Make room in --store.")


def test_a_vehicle_file_with_the_name_of_a_built_in_one_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "copter_default.toml"
    file.write_text((Path("twin/vehicle/built_in/copter_default.toml")).read_text())
    assert "Rename the file" in LogWork(1).do(checked(file))["error"]


def checked(log: Path) -> dict[str, str]:
    """A job that checks a file."""
    folder = str(log.parent)
    return {"kind": "check", "log": str(log), "folder": folder, "incoming": f"{folder}/run"}


def test_an_archive_of_too_many_logs_is_refused(tmp_path: Path) -> None:
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w") as archive:
        for k in range(MOST_LOGS + 1):
            archive.writestr(f"{k}.csv", "time\n0\n")
    (tmp_path / "many.zip").write_bytes(packed.getvalue())
    job = {"kind": "check", "log": str(tmp_path / "many.zip"), "folder": "", "incoming": ""}
    assert "Split it" in LogWork(1_000_000).do(job)["error"]


def test_a_mistake_of_ours_is_an_answer_too() -> None:
    assert "mistake of uavtwin" in LogWork(1).do({"kind": "why"})["error"]


def test_every_kind_has_a_worker() -> None:
    assert {*QUICK, *LONG, "warm"} == set(KINDS) and set(OF_VEHICLE) < set(KINDS)
    assert 0 < QUICK_SHARE < 1 and Limits().workers >= 2


def test_a_demonstration_flies_on_the_live_page(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    begin = "Begin the demonstration"
    whole = in_flight.damaged_flight
    monkeypatch.setattr(in_flight, "damaged_flight", lambda v: whole(v, 2.0, seconds=8.0))
    with site(tmp_path) as opened:
        assert begin in opened.ask("/live")[1]
        assert opened.ask("/live/demo", "POST")[0] == 303
        assert "Flight and twin" in opened.ask("/live")[1]
        assert opened.ask("/live/demo", "POST")[0] == 303, "one at a time"
        seen: set[str] = set()
        with connect(f"ws://127.0.0.1:{opened.port}/live/stream", proxy=None) as viewer:
            while not {"now", "health"} <= seen:
                seen |= {m["kind"] for m in json.loads(viewer.recv(timeout=60))}
        page = opened.wait("/live", "The last demonstration is over")
        assert begin in page and "rotor 3 lost 20 %" in page


def test_a_demonstration_ends_with_its_server(tmp_path: Path) -> None:
    before = threading.active_count()
    with site(tmp_path) as opened:
        opened.ask("/live/demo", "POST")
    assert threading.active_count() == before
