"""What moved the body: planted in simulated flights, found from the log alone."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from scipy.ndimage import gaussian_filter1d

from benchmarks.clean_flights import is_there
from benchmarks.sudden_faults.answers import trivial_rule
from benchmarks.sudden_faults.built_in import Planted
from benchmarks.sudden_faults.flights import Key, flown
from benchmarks.sudden_faults.kinds import GUST_S
from twin.logs import Flight
from twin.logs.columns import ACC, GYRO, POS, QUAT, VEL
from twin.vehicle.layouts import frame
from twin.vehicle_file import load_vehicle
from twin.why.body import Body
from twin.why.causes import ALL, BLOW, LOSSES, MASS, PUSH, ROTOR, Name
from twin.why.competition import SHOWN_GUST_S, Competition, drop
from twin.why.diagnose import FINDERS, diagnose
from twin.why.findings import Findings
from twin.why.flight import FlightFrame, lift, moment_signs, of_vehicle
from twin.why.motion import least_loss, moved
from twin.why.watch import Watch


def found_in(flight: Flight) -> Findings:
    return moved(FlightFrame.of(flight))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("size", "seed"), [(0.2, 2), (0.3, 1), (0.3, 3), (0.7, 1), (1.0, 1), (1.0, 5)]
)
def test_a_rotor_that_loses_thrust(size: float, seed: int) -> None:
    """Rotor, onset and size, of three aircraft; no vehicle is known."""
    flight, begins_s, rotor = Planted("rotor_failure", size, seed).flown()
    first = found_in(flight).events[0]
    assert first.cause == "rotor_failure" and first.rotor == (rotor,)
    assert first.onset_s == pytest.approx(begins_s, abs=0.1)
    assert first.severity is not None
    assert first.severity.value == pytest.approx(size, rel=0.25)
    assert first.severity.low <= first.severity.value <= first.severity.high


@pytest.mark.slow
def test_commands_at_ten_hertz_show_a_full_stop() -> None:
    flight, begins_s, rotor = Planted("rotor_failure", 1.0, 3, rate_hz=10.0).flown()
    found = diagnose(flight, finders=[*FINDERS[:1], moved])
    assert found.verdict == "found"
    assert found.events[0].rotor == (rotor,)
    assert found.events[0].onset_s == pytest.approx(begins_s, abs=0.1)
    assert found.loss_of_control_s is not None and found.loss_of_control_s > begins_s


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_a_windy_flight_has_no_event(seed: int) -> None:
    """The trivial rule is no detector: it names a rotor in flights like these."""
    found = found_in(Planted("", 0.0, seed).flown()[0])
    assert found.events == [] and found.nothing == 1.0


@pytest.mark.slow
def test_evidence_against_no_change_is_largest_at_the_onset() -> None:
    """Log odds of the right rotor peak within an interval of the truth."""
    flight, begins_s, rotor = Planted("rotor_failure", 0.3, 2).flown()
    frame = FlightFrame.of(flight)
    body = Body.of(frame, frame.airborne[-1])
    at = int(np.searchsorted(body.t_s, begins_s))
    tried = np.arange(at - 10, at + 10)
    competition = Competition(body)
    found = competition.odds(tried, 0, len(body), (0, len(body)))
    row = found.names.index(Name(ROTOR, (rotor or 0,)))
    assert abs(int(tried[np.argmax(found.odds[row])]) - at) <= 1
    assert found.odds[row].max() > found.nothing[row].max() + 100


def test_a_voltage_that_falls_at_the_end_of_a_log_falls() -> None:
    """What comes after the last sample is not the first one."""
    volts = np.where(np.arange(1000) < 990, 16.0, 13.0)
    fallen = drop(volts, 50)
    assert fallen[989] > 1.5
    assert fallen[-1] > 0 and np.all(fallen[:930] == 0)


@pytest.mark.slow
@pytest.mark.parametrize(("size", "seed", "rate_hz"), [(-0.3, 0, 200.0), (-0.3, 1, 10.0)])
def test_a_mass_that_drops(size: float, seed: int, rate_hz: float) -> None:
    """A step along z lasts: the slow part of the noise does not take it."""
    flight, begins_s, _ = Planted("mass_change", size, seed, rate_hz).flown()
    first = found_in(flight).events[0]
    assert first.cause == "mass_change" and first.severity is not None
    assert first.onset_s == pytest.approx(begins_s, abs=0.1)
    assert first.severity.value == pytest.approx(size, rel=0.25)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 3])
def test_a_gust_is_no_force_that_lasts(seed: int) -> None:
    flight, begins_s, _ = Planted("gust", 12.0, seed).flown()
    (first,) = found_in(flight).events
    assert first.cause == BLOW and first.onset_s is not None
    assert first.onset_s == pytest.approx(begins_s - 2 * GUST_S, abs=0.5)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [301, 2168, 2180])
def test_landings_punches_and_gusts_that_are_not_there_are_no_events(seed: int) -> None:
    """On the ground the controller asks for moments that legs take."""
    planted = Planted("", 1.0, seed, 50.0)
    flight = planted.flown()[0]
    assert [e for e in found_in(flight).events if not is_there(e, planted, flight)] == []


@pytest.mark.slow
@pytest.mark.parametrize("first", [True, False])
def test_a_part_that_shows_nothing_hides_no_event_of_another(first: bool) -> None:
    """The same flight twice, once with a gyroscope that reads 0; its motors idle between."""
    table = Planted("rotor_failure", 0.3, 3).flown()[0].table
    dead = table.assign(**dict.fromkeys(GYRO, 0.0))
    rest = table[:400].assign(**dict.fromkeys((c for c in table if c[:4] == "cmd_"), 0.0))
    whole = [dead, rest, table] if first else [table, rest, dead]
    begins = np.cumsum([0.0] + [t.time.iloc[-1] - t.time.iloc[0] + 0.005 for t in whole[:2]])
    whole = [t.assign(time=t.time - t.time.iloc[0] + b) for t, b in zip(whole, begins, strict=True)]
    found = found_in(Flight("two parts", pd.concat(whole, ignore_index=True)))
    alone = found_in(Flight("one part", table))
    assert [(e.cause, e.rotor) for e in found.events] == [(e.cause, e.rotor) for e in alone.events]
    assert found.events[0].cause == ROTOR
    hidden = {v.reason for v in found.not_visible if v.smallest_detectable.value is None}
    assert len(hidden) == 1 and "the gyroscope stands still" in hidden.pop()


def driven(authority: float = 60.0, jitter: float = 0.03, last: float = 1.0) -> Flight:
    """A climb in which random commands about hover turn an X by its signs; a gyroscope's noise. The
    last rotor is driven by so much more than the others."""
    rng, t = np.random.default_rng(2), np.arange(0.0, 18.0, 0.01)
    slow = gaussian_filter1d(rng.standard_normal((len(t), 4)), 5.0, axis=0)
    commands = 0.5 + jitter * slow / slow.std(axis=0) * [1.0, 1.0, 1.0, last]
    asked = (lift(commands) - lift(np.array(0.5))) @ moment_signs(frame("x")).T
    rates = 0.01 * np.cumsum(authority * asked[:, 1:], axis=0)
    rates -= gaussian_filter1d(rates, 100.0, axis=0)
    force = np.column_stack([0 * t, 0 * t, 15.0 * asked[:, 0] - 9.81])
    columns = {f"cmd_{i + 1}": commands[:, i] for i in range(4)}
    columns |= dict(zip(POS, (0 * t, 0 * t, -t), strict=True))
    for names, values, noise in ((GYRO, rates, 2e-3), (ACC, force, 0.05)):
        noisy = values + noise * rng.standard_normal(values.shape)
        columns |= dict(zip(names, noisy.T, strict=True))
    return Flight("driven", pd.DataFrame({"time": t} | columns))


@pytest.mark.parametrize(
    ("flight", "order", "reason"),
    [
        (driven(), [0, 1, 2, 3], ""),
        (
            driven(),
            [1, 0, 3, 2],
            "turns against the commands: its motors",
        ),
        (driven(last=2.2), [0, 1, 2, 3], ""),
        (
            driven(last=2.2),
            [1, 2, 0, 3],
            "turns unlike the commands: its motors",
        ),
        (driven(authority=0.5), [0, 1, 2, 3], "the gyroscope does not follow the commands"),
        (
            driven(jitter=1e-4),
            [0, 1, 2, 3],
            "change too little to tell",
        ),
        (driven(jitter=0.0), [0, 1, 2, 3], "the commands of the rotors never change"),
    ],
)
def test_why_a_body_shows_nothing_is_said_of_a_log_and_live(
    flight: Flight, order: list[int], reason: str
) -> None:
    copter = load_vehicle("copter_default")
    places, senses = copter.rotors.position_m[order], copter.rotors.direction[order]
    copter = replace(copter, rotors=replace(copter.rotors, position_m=places, direction=senses))
    found = found_in(of_vehicle(flight, copter))
    said = {v.reason for v in found.not_visible if v.smallest_detectable.value is None}
    assert len(said) == bool(reason) and all(reason in s for s in said)
    assert not found.events
    watch = Watch(copter)
    watch.push({str(c): v for c, v in flight.columns.items()})
    watch.evaluate()
    assert reason in watch.rests and bool(watch.rests) == bool(reason)


def test_the_least_loss_that_shows_is_that_of_the_noise_of_the_log() -> None:
    def least(noise: float) -> float:
        flight = driven()
        noisy = noise * np.random.default_rng(0).standard_normal((len(flight.table), 6))
        table = flight.table.copy()
        table[[*GYRO, *ACC]] += noisy
        found = found_in(Flight("noisy", table)).not_visible
        (known,) = [v.smallest_detectable.value for v in found if v.cause == ROTOR]
        return np.inf if known is None else known

    assert 0.1 < least(0.0) < least(0.2) < least(5.0) == np.inf


def test_a_loss_that_shows_in_a_part_of_the_flight_is_told_with_that_part() -> None:
    nats = np.full((5, len(LOSSES)), -1.0)
    assert least_loss(nats, 10.0).smallest_detectable.value is None
    assert "10 Hz" in least_loss(nats, 10.0).reason
    nats[0, -1] = nats[1, -2:] = 1.0
    least = least_loss(nats, 10.0)
    assert least.smallest_detectable.value == 1.0 and least.share == pytest.approx(0.4)
    nats[2] = 1.0
    least = least_loss(nats, 10.0)
    assert least.smallest_detectable.value == 1.0 and least.share is None


def test_of_motors_that_are_numbered_otherwise_nothing_is_said_but_what_to_do() -> None:
    copter = load_vehicle("copter_default")
    order = [1, 2, 0, 3]
    places, senses = copter.rotors.position_m[order], copter.rotors.direction[order]
    copter = replace(copter, rotors=replace(copter.rotors, position_m=places, direction=senses))
    other = diagnose(of_vehicle(driven(last=2.2), copter))
    assert "[rotors] of a vehicle file, and give that with --since." in other.text
    asked = [["is asked for" in n for n in d.notes] for d in (other, diagnose(driven(last=2.2)))]
    assert not any(asked[0]) and any(asked[1])


def test_rates_of_an_attitude_do_not_say_that_the_body_turns_against_the_commands() -> None:
    """Of a hover that a controller steadies, they are late and smooth."""
    flight = driven()
    table = flight.table.assign(**{c: -flight.table[c] for c in ("gyro_x", "gyro_y")})
    frame = FlightFrame.of(Flight("against", table))
    derived = replace(frame, flight=Flight("derived", table.drop(columns=list(GYRO))))
    said = [Body.of(f, f.airborne[0]).misnumbered for f in (frame, derived)]
    assert "turns against the commands" in said[0] and not said[1]


def test_the_least_gust_that_shows_is_told_and_half_of_it_is_not() -> None:
    """Across the thrust alone, in a flight whose force there is white noise."""
    table = driven().table
    hidden = found_in(Flight("calm", table)).not_visible
    (least,) = [v.smallest_detectable for v in hidden if v.cause == BLOW]
    assert least.unit == "m/s^2" and least.value is not None
    for share, told in ((0.5, False), (1.6, True)):
        phase = np.clip((table["time"] - 12.0) / SHOWN_GUST_S, 0.0, 2.0)
        gust = 0.5 * (1.0 - np.cos(np.pi * phase)) * share * least.value
        blown = table.assign(acc_y=table["acc_y"] + gust)
        assert [e.cause for e in found_in(Flight("blown", blown)).events] == [BLOW] * told


def test_thrust_falls_with_the_speed_along_the_axis_of_the_rotors() -> None:
    table = driven().table
    down = 2.0 * np.sin(1.3 * table["time"].to_numpy())
    table = table.assign(**dict.fromkeys((*VEL, *QUAT), 0.0)).assign(q_w=1.0, vel_z=down)
    table["acc_z"] -= 0.4 * down
    frame = FlightFrame.of(Flight("up and down", table))
    body = Body.of(frame, frame.airborne[0])
    left = (body.measured - body.expected())[:, 0]
    assert left.std() < 0.1 < (0.4 * down).std()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "size", "seed", "cause"),
    [
        ("rope", 0.2, 2052, PUSH),
        ("rope", 0.3, 11, PUSH),
        ("load gained", 0.2, 2053, MASS),
        ("battery", 0.2, 2052, ALL),
    ],
)
def test_what_acts_at_the_centre_of_mass_is_no_loss_of_all_rotors(
    kind: str, size: float, seed: int, cause: str
) -> None:
    """A rope and a load may bring no moment; the voltage speaks for all rotors, and against."""
    ((_, flight),) = flown([Key("own", kind, size, seed, 200.0)])
    first = found_in(flight.flight).events[0]
    assert first.cause == cause
    assert first.onset_s == pytest.approx(flight.begins_s, abs=0.1)


def test_a_voltage_that_falls_speaks_for_all_rotors_and_one_that_stays_against() -> None:
    """By more than a nat against a log without a voltage."""
    table = driven().table
    after = table["time"].to_numpy() > 12.0
    table.loc[after, "acc_z"] *= 0.8
    odds = []
    for volts in ({}, {"vbat_v": 16.0 * (1 - 0.106 * after)}, {"vbat_v": 16.0 + 0.0 * after}):
        frame = FlightFrame.of(Flight("less", table.assign(**volts)))
        body = Body.of(frame, frame.airborne[0])
        onset = np.array([int(np.searchsorted(body.t_s, 12.0))])
        found = Competition(body).odds(onset, 0, len(body))
        odds.append(found.odds[found.names.index(Name(ALL)), 0])
    unknown, falls, stays = odds
    assert falls > unknown + 1 > stays + 2


def test_height_is_over_the_ground_where_it_took_off_and_lands() -> None:
    """A barometer drifts by a metre; a record of what was flown alone knows no ground."""
    flown, t = driven().table, np.arange(0.0, 24.0, 0.01)
    height = np.interp(t, [0.0, 3.0, 5.0, 19.0, 21.0, 24.0], [0.0, 0.0, 5.0, 5.0, 1.0, 1.0])
    rows = np.clip(np.arange(len(t)) - 300, 0, len(flown) - 1)
    idle = dict.fromkeys((c for c in flown if c[:4] == "cmd_"), 0.05)
    table = flown.iloc[rows].reset_index(drop=True).assign(time=t, pos_z=-height)
    table.loc[(t < 3.0) | (t >= 21.0), list(idle)] = 0.05
    frame = FlightFrame.of(Flight("whole", table))
    (part,) = frame.airborne
    above = frame.above_ground_m[part.start : part.end]
    assert above[[0, -1]] == pytest.approx(0.77, abs=0.1)  # clear of it by 15 % of its reach
    assert above.max() == pytest.approx(4.8, abs=0.2)
    cut = FlightFrame.of(Flight("in the air", table[(t > 6.0) & (t < 18.0)]))
    assert cut.airborne and np.all(np.isinf(cut.above_ground_m))


def test_a_log_without_commands_says_what_it_cannot_show() -> None:
    t = np.arange(0, 20, 0.02)
    table = pd.DataFrame({"time": t, **{f"gyro_{a}": 0.01 * np.sin(t) for a in "xyz"}})
    found = found_in(Flight("imu", table))
    assert not found.events
    assert all(v.smallest_detectable.value is None for v in found.not_visible)


def test_a_hop_is_too_short_to_judge_rotors() -> None:
    table = driven().table
    found = found_in(Flight("hop", table[table["time"] < 7.0]))
    assert {v.reason for v in found.not_visible} == {"the log has no 8 s in the air"}


def test_the_trivial_rule_takes_the_highest_output() -> None:
    t = np.arange(0, 20, 0.1)
    table = {"time": t, **{f"cmd_{i}": np.full(len(t), 0.5) for i in range(1, 5)}}
    table["cmd_3"] = np.where(t > 12, 0.7, 0.5)
    read = trivial_rule(Flight("f", pd.DataFrame(table)))
    assert read is not None and read.rotor == 3 and read.t_s == pytest.approx(12.1)
