"""The page of `uavtwin why`, and its events as Diagnostic records."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from cli_rig import run
from msgspec import structs
from page_rigs.browser import (
    SOME_VIEWS,
    VIEWS,
    Browser,
    View,
    faults,
    needs_browser,
    pictures,
)
from why_rig import ONSET_S, sound

from twin.logs import Flight, write_flight
from twin.logs.autopilot import Autopilot, Interval, Message, Mode
from twin.why.records import (
    Amount,
    Candidate,
    Event,
    Kind,
    NotVisible,
    Severity,
    TimelineItem,
)
from uavtwin.diagnosis import WhyResult, least_in_words, why
from uavtwin.diagnostic import diagnostics
from uavtwin.report.drawing import PAGE_BYTES


def faulty() -> Flight:
    """A gyroscope that is off from `ONSET_S` on, and an autopilot that talks about it."""
    table = sound()
    table["gyro_y"] = table["gyro_y"] + 0.1 * (table["time"] >= ONSET_S)
    said = Autopilot(
        modes=(Mode("Hold", 0.0), Mode("Land", 40.0)),
        failsafes=(Interval("battery failsafe", 38.0, 44.0),),
        messages=(Message(ONSET_S + 0.5, "warning", "gyro <b>inconsistent</b>"),),
    )
    facts = {"clock": "t = 0 is 100.000000 s after boot, the start of the log"}
    return Flight("faulty", pd.DataFrame(table), autopilot=said, facts=facts)


@pytest.fixture(scope="module")
def result() -> WhyResult:
    return why(faulty())


def test_the_page_says_what_when_what_to_check_and_quotes(
    result: WhyResult, tmp_path: Path
) -> None:
    page = result.report(tmp_path / "why.html").read_text("utf-8")
    (cause,) = [e for e in result.record.events if not e.consequence]
    assert cause.cause == "gyro_bias"
    for text in (result.record.text, cause.bench_check, "What to do next", "could not have shown"):
        assert text.split("<")[0] in page
    assert "gyro &lt;b&gt;inconsistent&lt;/b&gt;" in page and "<b>inconsistent" not in page
    assert "mode Land" in page and "battery failsafe" in page
    assert "https://" not in page.split("plotly.js")[0]


def test_a_page_of_nothing_says_what_it_could_not_have_shown(tmp_path: Path) -> None:
    found = why(Flight("sound", pd.DataFrame(sound())))
    assert found.record.verdict == "cannot_tell"  # its commands never change
    page = found.report(tmp_path / "why.html").read_text("utf-8")
    assert "it is not excluded" in page and "below" in page


def test_the_trivial_rule_of_a_clean_flight_stands_below_the_answer(tmp_path: Path) -> None:
    table = sound()
    table["cmd_1"] = table["cmd_1"] + 0.2 * (abs(table["time"] - ONSET_S) < 0.05)
    found = why(Flight("parted", pd.DataFrame(table)))
    page = found.report(tmp_path / "why.html").read_text("utf-8")
    box, rest = page.split("<dt>in the air</dt>")[1].split("</dl>", 1)
    assert "rule" not in box and "rotor" not in box
    assert "A trivial rule, no finding:" in rest and "here rotor 1, at" in rest


def test_senseless_limits_and_hopeless_alternatives_are_not_listed(result: WhyResult) -> None:
    def hidden(cause: str, value: float, unit: str) -> NotVisible:
        least = Amount(value=value, unit=unit)
        return NotVisible(cause=cause, smallest_detectable=least, reason="r")

    any_size = [("mag_hard_iron", 1.07, "1"), ("baro_bias", 61.2, "m"), ("imu_tilt", 1.6, "rad")]
    sensible = [("mag_hard_iron", 0.27, "1"), ("gyro_bias", 2.0, "rad/s"), ("baro_bias", 4.0, "m")]
    assert {least_in_words(hidden(*v)) for v in any_size} == {"of any size"}
    assert all(least_in_words(hidden(*v)).startswith("below") for v in sensible)
    others = [Candidate(cause=c, rotor=None, probability=p) for c, p in (("a", 0.1), ("b", 0.009))]
    event = structs.replace(result.record.events[0], alternatives=tuple(others))
    least = (hidden("rotor_failure", 0.1, "1"), hidden("gyro_bias", 0.05, "rad/s"))
    record = structs.replace(result.record, events=(event,), not_visible=least)
    parts = list(WhyResult(record).findings())
    (table,) = [p for p in parts if not isinstance(p, str)]
    assert table.rows[0][-1] == "a 10 %"
    (line,) = [p for p in parts if isinstance(p, str) and "Not visible" in p]
    assert (
        line.startswith("Not visible: rotor failure below 10 % of a rotor's thrust.")
        and "gyro" not in line
    )


def test_a_result_without_its_flight_has_a_page(result: WhyResult, tmp_path: Path) -> None:
    page = replace(result, recorded=None).report(tmp_path / "why.html").read_text("utf-8")
    assert result.record.text in page


@needs_browser
@pytest.mark.parametrize("view", SOME_VIEWS, ids=str)
def test_the_page_is_fine_to_look_at(
    opened: Browser, result: WhyResult, view: View, tmp_path: Path
) -> None:
    page = result.report(tmp_path / "why.html")
    assert faults(opened, page, view, pictures(tmp_path) / f"why_{view}.png") == []
    assert page.stat().st_size < PAGE_BYTES


@needs_browser
def test_a_crash_soon_after_its_cause_is_fine_to_look_at(
    opened: Browser, result: WhyResult, tmp_path: Path
) -> None:
    """Marks of two instants that are close do not lie on each other."""
    from msgspec.structs import replace as changed

    items = [TimelineItem(kind=k, t_s=ONSET_S + d, text=k) for k, d in _CRASH]
    timeline = (*result.record.timeline, *items)
    record = changed(result.record, timeline=timeline, loss_of_control_s=ONSET_S + 0.2)
    page = replace(result, record=record).report(tmp_path / "why.html")
    assert faults(opened, page, VIEWS[3], None) == []
    assert "control lost" in page.read_text("utf-8")


_CRASH: tuple[tuple[Kind, float], ...] = (("loss_of_control", 0.2), ("crash", 1.5))


def test_diagnostic_records_have_the_keys_and_the_clock_of_flight_review(
    result: WhyResult,
) -> None:
    first = diagnostics(result)[0]
    times = ["timestamp_us", "end_timestamp_us"]
    assert list(first) == ["id", "summary", "severity", *times, "evidence"]
    assert first["id"] == "gyro_bias" and first["severity"] == "warning"
    assert first["timestamp_us"] == pytest.approx(1e6 * (100.0 + ONSET_S), abs=0.3e6)
    assert first["evidence"]["type"] == "Event"


def test_a_failed_rotor_is_a_motor_failure_of_theirs(result: WhyResult) -> None:
    failed = Event(
        cause="rotor_failure",
        rotor=(2,),
        onset_s=30.0,
        severity=Severity(quantity="thrust_lost", value=0.5, low=0.4, high=0.6, unit="1"),
        probability=0.9,
        alternatives=(Candidate(cause="gust", rotor=None, probability=0.1),),
    )
    from msgspec.structs import replace as changed

    record = changed(result.record, events=(failed,), loss_of_control_s=31.0)
    (said,) = diagnostics(replace(result, record=record))
    assert said["id"] == "motor_failure" and said["severity"] == "critical"
    evidence = {"type": "MotorFailure", "motor_index": 1, "flight_mode": "Hold"}
    assert evidence.items() <= said["evidence"].items()
    assert said["evidence"]["pwm_value"] == pytest.approx(1500.0)


def test_the_verb_writes_both_and_keeps_what_is_there(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    log, page, records = (tmp_path / n for n in ("log.parquet", "why.html", "why.json"))
    write_flight(faulty(), log)
    asked = ("why", log, "--out", page, "--diagnostic", records)
    code, said, _ = run(capsys, *asked)
    assert code == 1 and "gyro" in said
    assert page.read_text("utf-8").startswith("<!DOCTYPE html>")
    assert np.all([r["timestamp_us"] > 0 for r in json.loads(records.read_text("utf-8"))])
    assert run(capsys, *asked)[0] == 2
    assert run(capsys, *asked, "--force")[0] == 1
    assert run(capsys, "why", log, "--out", tmp_path / "why.pdf")[0] == 2


def test_several_logs_have_a_result_each_and_a_table(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """One that cannot be read hides none of the others."""
    logs = [tmp_path / f"{n}.parquet" for n in ("faulty", "sound")]
    for log, flight in zip(logs, (faulty(), Flight("sound", pd.DataFrame(sound()))), strict=True):
        write_flight(flight, log)
    code, said, _ = run(capsys, "why", *logs)
    assert code == 1 and said.count("To check:") == 1
    table = said[said.index("control lost") :]
    assert "gyro bias, gyro_y" in table and "cannot tell" in table
    code, said, error = run(capsys, "why", *logs, tmp_path / "absent.ulg", "--json")
    assert code == 2 and "absent" in error
    *read, unread = json.loads(said)
    assert [r["verdict"] for r in read] == ["found", "cannot_tell"]
    assert unread.keys() == {"flight", "error"} and unread["flight"] == "absent"
    assert "absent.ulg" in unread["error"]
    code, said, _ = run(capsys, "why", tmp_path / "absent.ulg", logs[1])
    rows = said[said.index("control lost") :].splitlines()
    assert code == 2 and any("absent" in r and "not read" in r for r in rows)
    code, said, _ = run(capsys, "why", tmp_path / "a.ulg", tmp_path / "b.ulg", "--json")
    assert code == 2 and [r["flight"] for r in json.loads(said)] == ["a", "b"]
    assert run(capsys, "why", *logs, "--out", tmp_path / "two.html")[0] == 2
