"""The twin that follows the aircraft, and what is published of it."""

import json
import socket
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest
from msgspec import structs
from sample_logs import flown_table

from twin.logs.mavlink.decoder import Sample
from twin.logs.mavlink.frames import Message, parser
from twin.residuals.stream import Equations, Rows
from twin.vehicle import Vehicle
from twin.vehicle_file import load_vehicle
from twin.why.records import Candidate, Event, Severity
from twin.why.watch import Alarm
from uavtwin.live.following import Following, FollowingTwin, Publisher
from uavtwin.live.recording import Recording
from uavtwin.live.status import sentence
from uavtwin.live.worker import Batch, Worker
from uavtwin.sockets import Address


@pytest.fixture(scope="module")
def copter() -> Vehicle:
    return load_vehicle("copter_default")


WEAK = Alarm(
    event=Event(
        cause="rotor_failure",
        rotor=(3,),
        onset_s=1.5,
        severity=Severity(quantity="thrust_lost", value=0.2, low=0.16, high=0.24, unit="1"),
        probability=0.93,
        alternatives=(Candidate(cause="mass_change", rotor=None, probability=0.06),),
        text="Rotor 3 loses 20 % of its thrust at 1.50 s",
    ),
    raised_s=3.0,
    known_s=2.0,
)


@dataclass
class Listener:
    """Raises an alarm when it has seen a second."""

    seen: list[float] = field(default_factory=list)
    misfit: str = ""
    rests: str = ""
    said: bool = False

    def push(self, rows: Rows) -> None:
        self.seen += rows["time"].tolist()

    def evaluate(self) -> tuple[Alarm, ...]:
        told, self.said = not self.said and self.seen[-1] > 1.0, True
        return (WEAK,) if told else ()


def test_an_alarm_says_what_has_happened_and_what_else_it_could_be() -> None:
    assert sentence(WEAK) == (
        "Rotor 3 loses 20 % of its thrust at 1.50 s (thrust lost 20 % (16 to 24), 93 %); "
        "or mass change (6 %)"
    )
    assert sentence(structs.replace(WEAK, closed_s=25.0)).endswith("(6 %); over since 25.0 s")


def test_it_follows_in_the_steps_of_the_fmus(copter: Vehicle) -> None:
    """From a measured state on: the airframe's own step, however readings come."""
    equations = Equations(copter, "command")
    twin, body = FollowingTwin(equations, Following(10.0)), equations.airframe
    measured = {"pos": (1.0, 2.0, -3.0), "vel": (0.5, 0.0, 0.0), "q": (1.0, 0.0, 0.0, 0.0)}
    command = Sample("cmd", "x", 0, (0.5, 0.52, 0.5, 0.52))
    assert not twin.take(command)
    for group, values in measured.items():
        assert not twin.take(Sample(group, "x", 0, values))
    assert not twin.started
    for t_us in (1_000_000, 1_005_000, 1_027_000, 1_100_000):
        assert twin.take(Sample("gyro", "x", t_us, (0.1, 0.0, 0.0)))
    u = body.input_values({f"cmd_{i}": v for i, v in enumerate(command.values, 1)})
    p = body.parameter_values({"ground.enabled": 0.0})
    x = np.asarray(body.initial(u, body.parameter_values({"ground.enabled": 0.0})), float).ravel()
    names = [s.name for s in body.states]
    for name, value in zip(
        ("pos_x", "pos_y", "pos_z", "vel_x", "q_w", "omega_x"),
        (1.0, 2.0, -3.0, 0.5, 1.0, 0.1),
        strict=True,
    ):
        x[names.index(name)] = value
    for _ in range(100):
        x = body.advance(x, u, p, 1e-3)
    read = twin.read()
    place = [names.index(f"pos_{a}") for a in "xyz"]
    np.testing.assert_allclose(read.position_n, x[place], rtol=0, atol=1e-12)
    np.testing.assert_allclose(read.omega_b[0], x[names.index("omega_x")], atol=1e-12)


def test_it_is_set_to_what_was_measured_every_horizon(copter: Vehicle) -> None:
    twin = FollowingTwin(Equations(copter, "command"), Following(0.1))
    twin.take(Sample("cmd", "x", 0, (0.0,) * 4))
    twin.take(Sample("vel", "x", 0, (0.0,) * 3))
    twin.take(Sample("q", "x", 0, (1.0, 0.0, 0.0, 0.0)))
    fallen = []
    for k in range(25):
        twin.take(Sample("gyro", "x", 10_000 * k, (0.0,) * 3))
        fallen.append(twin.read().velocity_n[2])
    assert fallen[0] == fallen[10] == fallen[20] == 0.0
    assert 0.5 < fallen[9] < fallen[19] < 0.95  # the rotors slow down all the while


def test_an_observer_draws_it_to_what_was_measured(copter: Vehicle) -> None:
    """What it is off decays with the time constant, where equations add nothing: its heading."""
    quiet = Equations(copter, "command")
    apart = []
    for observer_s in (0.5, None):
        twin = FollowingTwin(quiet, Following(100.0, observer_s))
        for sample in (("cmd", (0.0,) * 4), ("vel", (0.0,) * 3), ("q", (1.0, 0.0, 0.0, 0.0))):
            twin.take(Sample(sample[0], "x", 0, sample[1]))
        twin.take(Sample("gyro", "x", 0, (0.0,) * 3))
        turned = (np.cos(0.05), 0.0, 0.0, -np.sin(0.05))
        twin.take(Sample("q", "x", 0, tuple(-x for x in turned)))  # the same attitude
        for k in range(1, 101):
            twin.take(Sample("gyro", "x", 10_000 * k, (0.0,) * 3))
        q = np.asarray(twin.read().q_nb)
        assert np.linalg.norm(q) == pytest.approx(1.0, abs=1e-12)
        apart.append(float(np.arccos(abs(q @ turned)) / 0.05))
    assert apart == pytest.approx([np.exp(-1.0 / 0.5), 1.0], rel=1e-3)


@pytest.mark.slow
def test_alarms_reach_the_recording_and_the_ground_station(copter: Vehicle, tmp_path: Path) -> None:
    """Who looks gets each row, in order; alarms are a line, a text and a number."""
    listener, recording = Listener(), Recording(tmp_path / "rec", 4)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as station:
        station.bind(("127.0.0.1", 0))
        station.settimeout(1.0)
        publisher = Publisher(Address("127.0.0.1", station.getsockname()[1]), 4)
        worker = Worker(copter, recording, 0.5, watch=lambda: listener, on_alarm=publisher.alarm)
        table = flown_table().iloc[:400]
        for first in range(0, 400, 50):
            part = table.iloc[first : first + 50]
            worker.add(Batch({str(c): part[c].to_numpy() for c in part}, {}, ()))
        worker.close()
        recording.close()
        publisher.tick(2)  # the aircraft has the id that the twin would have
        publisher.close()
        reader = parser()
        heard: list[Message] = []
        while not heard or heard[-1].get_type() != "NAMED_VALUE_FLOAT":
            heard += reader.parse_buffer(station.recv(1000)) or ()
    assert listener.seen == table["time"].tolist()
    (line,) = (tmp_path / "rec" / "alarms.jsonl").read_text("utf-8").splitlines()
    assert json.loads(line)["cause"] == "rotor_failure" and json.loads(line)["section"] == 1
    first, *texts, number = heard
    assert first.get_type() == "HEARTBEAT" and first.get_srcSystem() == 3
    assert {m.get_type() for m in texts} == {"STATUSTEXT"}
    assert "".join(m.text for m in texts) == sentence(WEAK)
    assert number.name == "rotor_fail" and number.value == pytest.approx(0.93)
