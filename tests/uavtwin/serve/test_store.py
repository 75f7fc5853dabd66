"""The folder of the page: what is queued is done, whatever ends meanwhile."""

import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from twin.errors import TwinError
from uavtwin.explain_journal import JOURNAL
from uavtwin.serve import store as store_module
from uavtwin.serve.store import MOST_TRIES, SHOWN, Store, safe_name

pytestmark = pytest.mark.slow
ALL = ("check", "why", "gap", "explain")


def added(store: Store, content: bytes = b"log", name: str = "a.ulg") -> str:
    with store.upload(1000) as coming:
        coming.write(content)
        return store.add(name, coming.path, coming.sha256, coming.size)[0]


def test_a_log_becomes_a_row_with_its_first_job(tmp_path: Path) -> None:
    store = Store(tmp_path)
    flight = added(store, b"content", "../../flight 1.ulg")
    row = store.flight(flight)
    assert row is not None and row.name == "flight_1.ulg" and row.bytes == 7
    assert store.log(row).read_bytes() == b"content"
    assert [(j.kind, j.state) for j in store.jobs(flight)] == [("check", "queued")]
    assert not list((tmp_path / "incoming").iterdir())


def test_the_same_log_is_one_row(tmp_path: Path) -> None:
    store = Store(tmp_path)
    assert added(store, b"one") == added(store, b"one", "b.ulg")
    assert store.flights()[1] == 1


def test_what_was_running_is_queued_again_after_a_kill(tmp_path: Path) -> None:
    script = (
        "import os, sys; from pathlib import Path; from uavtwin.serve.store import Store\n"
        "store = Store(Path(sys.argv[1]))\n"
        "with store.upload(9) as c:\n"
        "    c.write(b'log'); store.add('a.ulg', c.path, c.sha256, c.size)\n"
        "assert store.take(['check']).state == 'queued'\n"
        "os.kill(os.getpid(), 9)\n"
    )
    subprocess.run([sys.executable, "-c", script, str(tmp_path)], check=False)
    store = Store(tmp_path)
    ((flight,), count) = store.flights()
    (job,) = store.jobs(flight.id)
    assert count == 1 and job.state == "queued" and job.tries == 1


def test_a_job_that_ends_the_server_is_not_begun_for_ever(tmp_path: Path) -> None:
    store = Store(tmp_path)
    flight = added(store)
    for _ in range(MOST_TRIES):
        assert store.take(ALL) is not None
        store._tables.close()  # without a word: as a kill leaves it
        store = Store(tmp_path)
    (job,) = store.jobs(flight)
    assert job.state == "failed" and "the server ended 3 times" in str(job.text)
    assert store.take(ALL) is None


def test_an_end_that_was_asked_for_is_no_failure_of_a_job(tmp_path: Path) -> None:
    store = Store(tmp_path)
    flight = added(store)
    for _ in range(MOST_TRIES + 1):
        assert store.take(ALL) is not None
        store.close()
        store = Store(tmp_path)
    assert store.jobs(flight)[0].state == "queued"


def test_the_most_urgent_job_comes_first_and_only_kinds_that_are_asked_for(tmp_path: Path) -> None:
    store = Store(tmp_path)
    first = added(store, b"1")
    store.queue(first, "explain")
    second = added(store, b"2")
    taken = [store.take(ALL) for _ in range(3)]
    assert [(j.flight, j.kind) for j in taken if j] == [
        (first, "check"),
        (second, "check"),
        (first, "explain"),
    ]
    store.queue(first, "gap")
    assert store.take(["check", "why"]) is None


def test_a_job_is_open_once_and_can_be_asked_for_again_when_it_has_ended(tmp_path: Path) -> None:
    store = Store(tmp_path)
    flight = added(store)
    assert not store.queue(flight, "check")
    job = store.take(ALL)
    assert job is not None and not store.queue(flight, "check")
    assert store.end(job, "cancelled") and not store.end(job, "done")
    assert store.queue(flight, "check")
    assert len(store.jobs(flight)) == 1


def test_a_search_finds_all_words_in_any_case(tmp_path: Path) -> None:
    store = Store(tmp_path)
    hexa, quad = added(store, b"1", "Hexa_maiden.ulg"), added(store, b"2", "quad.ulg")
    store.note(quad, tags="windy maiden", why_text="Rotor 3 failed", nonsense="x")
    assert [f.id for f in store.flights("MAIDEN")[0]] == [quad, hexa]
    assert [f.id for f in store.flights("maiden rotor")[0]] == [quad]
    assert store.flights("%")[1] == 0 and store.flights("' OR 1=1 --")[1] == 0


def test_another_vehicle_forgets_what_came_of_the_former(tmp_path: Path) -> None:
    store = Store(tmp_path)
    flight = added(store)
    store.choose(flight, "first")
    store.note(flight, gap_text="a gap of the first")
    store.queue(flight, "explain")
    store.choose(flight, "second")
    row = store.flight(flight)
    assert row is not None and (row.vehicle, row.gap_text) == ("second", None)
    assert [(j.kind, j.state) for j in store.jobs(flight)] == [
        ("check", "queued"),
        ("gap", "queued"),
    ]


def test_a_long_list_shows_the_newest_and_counts_all(tmp_path: Path) -> None:
    store = Store(tmp_path)
    store._write(
        "INSERT INTO flights (id, name, added_s, tags) SELECT 'f' || i, 'x', i, '' "
        "FROM range(?) t(i)",
        (SHOWN + 5,),
    )
    rows, count = store.flights()
    assert (len(rows), count, rows[0].id) == (SHOWN, SHOWN + 5, f"f{SHOWN + 4}")


def test_deleting_a_flight_leaves_nothing_of_it(tmp_path: Path) -> None:
    store = Store(tmp_path)
    flight = store.flight(added(store))
    assert flight is not None
    (store.results(flight.id) / "why.html").write_text("x")
    store.delete(flight)
    assert store.flight(flight.id) is None and store.jobs(flight.id) == []
    assert not [p for p in tmp_path.rglob("*") if flight.id in str(p)]


def test_a_log_that_comes_again_while_it_is_deleted_stays(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    store = Store(tmp_path)
    flight = store.flight(added(store))
    assert flight is not None
    remove = shutil.rmtree

    def again(place: Path, ignore_errors: bool) -> None:
        added(store)
        remove(place, ignore_errors)

    monkeypatch.setattr(shutil, "rmtree", again)
    store.delete(flight)
    assert store.log(flight).read_bytes() == b"log"


def test_a_vehicle_of_the_same_name_gets_a_number(tmp_path: Path) -> None:
    store = Store(tmp_path / "store")
    file = tmp_path / "mine.toml"
    names = []
    for content in ("one", "two", "one", "two", "three"):
        file.write_text(content)
        names.append(store.add_vehicle(file))
    assert names == ["mine", "mine-2", "mine", "mine-2", "mine-3"]
    mine = store.vehicle_file("mine")
    assert mine is not None and mine.read_text() == "one"
    built_in = file.rename(tmp_path / "copter_default.toml")
    assert store.add_vehicle(built_in) == "copter_default-2"


def test_an_end_is_of_one_run(tmp_path: Path) -> None:
    store = Store(tmp_path)
    flight = added(store)
    first = store.take(ALL)
    assert first is not None and store.is_running(first) and store.end(first, "cancelled")
    store.queue(flight, "check")
    assert not store.is_running(first) and not store.end(first, "failed", "of before")
    second = store.take(ALL)
    assert second is not None and store.is_running(second) and not store.is_running(first)


def test_what_a_killed_server_unpacked_is_gone(tmp_path: Path) -> None:
    store = Store(tmp_path)
    added(store)
    job = store.take(ALL)
    assert job is not None
    store.incoming(job).mkdir()
    (store.incoming(job) / "0").write_text("half")
    store.close()
    Store(tmp_path)
    assert not list((tmp_path / "incoming").iterdir())


def test_too_much_is_refused_while_it_comes(tmp_path: Path) -> None:
    store = Store(tmp_path)
    with pytest.raises(TwinError, match="--size-limit"), store.upload(10) as coming:
        coming.write(b"12345678")
        coming.write(b"90123")
    assert not list((tmp_path / "incoming").iterdir())


def test_a_store_is_of_one_server(tmp_path: Path) -> None:
    opened = Store(tmp_path)
    script = "import sys; from pathlib import Path; from uavtwin.serve.store import Store\n"
    script += "Store(Path(sys.argv[1]))"
    told = subprocess.run(
        [sys.executable, "-c", script, str(tmp_path)], capture_output=True, text=True, check=False
    )
    assert "another server has it open" in told.stderr
    opened.close()


def test_a_file_in_the_place_of_the_store_is_said(tmp_path: Path) -> None:
    (tmp_path / "x").write_text("")
    with pytest.raises(TwinError, match="--store"):
        Store(tmp_path / "x")
    (tmp_path / "store.duckdb").write_text("no database, but long enough to be looked at " * 200)
    with pytest.raises(TwinError, match="is no table of flights"):
        Store(tmp_path)


def test_the_token_is_of_the_store_and_for_its_owner(tmp_path: Path) -> None:
    store = Store(tmp_path)
    token = store.token()
    assert len(token) >= 32 and store.token() == token
    assert (tmp_path / "token").stat().st_mode & 0o077 == 0
    for cut_short in ("", "\n", token[:5]):
        (tmp_path / "token").write_text(cut_short)
        (tmp_path / "token.new").write_text("half")
        assert len(store.token()) >= 32 and store.token() != token
    assert (tmp_path / "token").stat().st_mode & 0o077 == 0


@settings(max_examples=50)
@given(st.text())
def test_names_of_others_stay_in_their_folder(name: str) -> None:
    made = safe_name(name)
    assert made and len(made) <= 80 and made[0] not in "._-"
    assert Path(made).name == made and made.isascii()


@pytest.mark.parametrize(
    ("name", "made"),
    [
        ("a.ulg", "a.ulg"),
        ("C:\\logs\\b.bin", "b.bin"),
        ("..", "log"),
        ("", "log"),
        (f"{'x' * 300}.parquet", f"{'x' * 70}.parquet"),
    ],
)
def test_names(name: str, made: str) -> None:
    assert safe_name(name) == made


def test_the_server_starts_light() -> None:
    assert store_module.JOURNAL == JOURNAL
    code = (
        "import sys, uavtwin.serve.server; print({'pandas', 'scipy', 'pyarrow'} & {*sys.modules})"
    )
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout.strip() == "set()"


def mapped(
    store: Store, name: str, content: str = '[acc]\ntopic = "/imu"\nfields = ["a"]\n'
) -> Any:
    with store.upload(1000) as coming:
        coming.write(content.encode())
        return store.add_mapping(name, coming.path)


def test_a_mapping_has_its_bags_done_again_with_what_was_there(tmp_path: Path) -> None:
    store = Store(tmp_path)
    bag, other = added(store, b"bag", "day.mcap"), added(store, b"log", "day.ulg")
    known = added(store, b"table", "day.db3")
    store.note(known, format="flight table, Parquet", verdict="fine")
    for flight in (bag, other):
        store.note(flight, verdict="fine", explain_text="drag")
        for kind in ("why", "explain", "fmu"):
            store.queue(flight, kind)
        while (job := store.take((*ALL, "fmu"))) is not None:
            store.end(job, "done")
    (store.results(bag) / JOURNAL).write_bytes(b"of the former columns")
    assert mapped(store, "day.topics.toml") == {bag: ["check", "why", "explain"]}
    states = {j.kind: j.state for j in store.jobs(bag)}
    assert states == {"fmu": "done", "check": "queued", "explain": "queued"}, "check queues why"
    assert not (store.results(bag) / JOURNAL).exists()
    for flight, text in ((bag, None), (other, "drag")):
        row = store.flight(flight)
        assert row is not None and row.explain_text == text
        assert (store.log(row).with_name("day.topics.toml")).exists() == (flight == bag)
    assert {j.state for j in store.jobs(other)} == {"done"}


@pytest.mark.parametrize(
    ("name", "content", "said"),
    [
        ("day.topics.toml", "\0nonsense", "day.topics.toml: no mapping of topics"),
        ("day.topics.toml", "acc = 1", "Write a table for each signal"),
        ("day.topics.toml", "a = " + "[" * 900, "no mapping of topics"),
        (".topics.toml", "", "Call it as the bag"),
    ],
)
def test_what_is_no_mapping_changes_nothing(
    tmp_path: Path, name: str, content: str, said: str
) -> None:
    store = Store(tmp_path)
    flight = added(store, b"bag", "day.mcap")
    store.note(flight, verdict="fine")
    with pytest.raises(TwinError, match=said):
        mapped(store, name, content)
    row = store.flight(flight)
    assert row is not None and row.verdict == "fine"
    assert not list((tmp_path / "mappings").iterdir())
