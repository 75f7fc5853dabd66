"""The master: what each algorithm computes, rates, recordings, refusals, what it leaves behind."""

import os
import tempfile
import zipfile
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from numpy.typing import NDArray

from cosim.master import Algorithm, Master
from cosim.system import Connection, System, connect
from fmus import build, component_model, replay_model
from twin.component import Component, ComponentBuilder
from twin.errors import FmuError
from twin.logs import Flight
from twin.physics.airframe import airframe
from twin.physics.sensors.imu import imu
from twin.vehicle_file import load_vehicle

Array = NDArray[np.float64]
H = 1e-3
VEHICLE = load_vehicle("copter_default")
BODY, SENSOR = airframe(VEHICLE), imu(VEHICLE)
FILTERED = imu(replace(VEHICLE, accel_cutoff_hz=80.0, gyro_cutoff_hz=60.0))
STARTS = {
    "initial.omega_x": 0.7,
    "initial.omega_y": -0.5,
    "initial.omega_z": 0.6,
    "initial.vel_y": 2.0,
    "wind_x": 3.0,
    "drag.linear_x": 0.2,
}
SYSTEM_STARTS = {f"airframe.{n}": v for n, v in STARTS.items()}


def proportional() -> Component:
    """Commands from the height without delay: closes a loop that is no algebraic one."""
    m = ComponentBuilder("height", "Proportional height controller")
    pos_z = m.input("pos_z", "m", "Position down")
    for i in range(1, 5):
        m.output(f"cmd_{i}", "1", f"Command {i}", 0.4 + 0.05 * (pos_z + 9.0))
    return m.build()


@pytest.fixture(scope="module")
def fmu(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Path]:
    folder = tmp_path_factory.mktemp("fmus")
    made: dict[tuple[str, int], Path] = {}
    components = {
        "airframe": BODY,
        "imu": SENSOR,
        "filtered": FILTERED,
        "no_lag": airframe(load_vehicle("feisi_x150")),
        "height": proportional(),
    }

    def get(name: str, fmi: int = 2) -> Path:
        if (name, fmi) not in made:
            path = folder / f"{name}{fmi}.fmu"
            made[name, fmi] = build(component_model(components[name]), path, fmi)
        return made[name, fmi]

    return get


@pytest.fixture
def system(fmu: Callable[..., Path]) -> System:
    return System(
        {"airframe": fmu("airframe"), "imu": fmu("imu")},
        connect("airframe", "imu", SENSOR.input_names),
        SYSTEM_STARTS,
    )


def evaluate(c: Component, x: Array, u: Array) -> Array:
    return np.asarray(c.outputs(x, u, c.parameter_values()), dtype=np.float64).ravel()


def column(values: Array, names: tuple[str, ...], wanted: tuple[str, ...]) -> Array:
    return values[:, [names.index(n) for n in wanted]]


def recorded(system: System, algorithm: Algorithm, steps: int = 50) -> tuple[Array, Array]:
    """Outputs of the airframe and of the IMU at the communication points."""
    with Master(system) as master:
        master.initialize()
        values = master.run(steps * H, H, algorithm).values
        names = master.record_names
    split = len(BODY.output_names)
    assert names[:split] == tuple(f"airframe.{n}" for n in BODY.output_names)
    return values[:, :split], values[:, split:]


def fed(body: Array) -> Array:
    """What the airframe gives to the IMU."""
    return column(body, BODY.output_names, SENSOR.input_names)


# -- algorithms -----------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize(
    ("algorithm", "late"), [("jacobi", 1), ("settled", 0), ("gauss_seidel", 0)]
)
def test_what_a_sensor_shows(system: System, algorithm: Algorithm, late: int) -> None:
    """A sensor without states shows the present, or with plain Jacobi the previous instant."""
    body, sensor = recorded(system, algorithm)
    inputs = fed(body)
    felt = np.vstack([inputs[:1], inputs[:-1]]) if late else inputs
    expected = np.array([evaluate(SENSOR, np.zeros(0), u) for u in felt])
    np.testing.assert_allclose(sensor, expected, rtol=1e-14, atol=1e-14)
    assert np.abs(np.diff(sensor, axis=0)).max() > 1e-4  # or present and past were the same


def test_algorithms_agree_on_what_has_no_input(system: System) -> None:
    """The airframe hears nobody: the same bits whoever steps it."""
    runs = [recorded(system, a)[0].tobytes() for a in ("jacobi", "settled", "gauss_seidel")]
    assert len(set(runs)) == 1


def test_gauss_seidel_order_does_not_depend_on_the_order_of_fmus(system: System) -> None:
    turned = replace(system, fmus=dict(reversed([*system.fmus.items()])))
    with Master(turned, [f"imu.{n}" for n in SENSOR.output_names]) as master:
        master.initialize()
        values = master.run(50 * H, H, "gauss_seidel").values
    assert values.tobytes() == recorded(system, "gauss_seidel")[1].tobytes()


@pytest.mark.parametrize("algorithm", ["jacobi", "settled", "gauss_seidel"])
def test_first_row_is_settled(system: System, algorithm: Algorithm) -> None:
    body, sensor = recorded(system, algorithm, steps=0)
    expected = evaluate(SENSOR, np.zeros(0), fed(body)[0])
    np.testing.assert_allclose(sensor[0], expected, rtol=1e-15)
    assert body[0, BODY.output_names.index("vel_y")] == 2.0


@pytest.mark.parametrize("algorithm", ["jacobi", "settled", "gauss_seidel"])
@pytest.mark.parametrize("period", [1, 5])
def test_rates_against_a_loop_by_hand(
    fmu: Callable[..., Path], algorithm: Algorithm, period: int
) -> None:
    """A filtered IMU at a fifth of the rate: it holds its input over its own step."""
    system = System(
        {"airframe": fmu("airframe"), "imu": fmu("filtered")},
        connect("airframe", "imu", FILTERED.input_names),
        SYSTEM_STARTS,
        {"imu": period},
    )
    body, sensor = recorded(system, algorithm, steps=23)
    inputs, p = fed(body), FILTERED.parameter_values()
    x = np.asarray(FILTERED.initial(inputs[0], p), dtype=np.float64).ravel()
    expected = [evaluate(FILTERED, x, inputs[0])]
    for k in range(1, 24):
        if k % period == 0:
            held = inputs[k] if algorithm == "gauss_seidel" else inputs[k - period]
            x = FILTERED.advance(x, held, p, period * H)
            expected.append(evaluate(FILTERED, x, held))
        else:
            expected.append(expected[-1])
    np.testing.assert_allclose(sensor, expected, rtol=1e-12, atol=1e-12)
    assert 23 // period <= len(np.unique(sensor[:, 0])) <= 23 // period + 1


def test_two_runs_are_one(system: System) -> None:
    with Master(system) as master:
        master.initialize()
        whole = master.run(40 * H, H)
        master.initialize()
        first, second = master.run(15 * H, H), master.run(40 * H, H)
    assert whole.values.tobytes() == np.vstack([first.values, second.values[1:]]).tobytes()
    assert second.time_s[0] == first.time_s[-1]


def test_start_time_every_and_start_values(system: System) -> None:
    reports: list[float] = []
    with Master(system) as master:
        master.initialize(10.0, {"airframe.initial.pos_x": 4.0})
        sparse = master.run(12.0, H, every=7, progress=reports.append)
        master.initialize(10.0, {"airframe.initial.pos_x": 4.0})
        dense = master.run(12.0, H)
        master.initialize()
        assert master.run(0.0, H)["airframe.pos_x"][0] == 0.0  # not kept from the run before
    assert sparse["airframe.pos_x"][0] == 4.0
    assert sparse.values.tobytes() == dense.values[::7].tobytes()
    np.testing.assert_allclose(sparse.time_s, 10.0 + 7 * H * np.arange(286), rtol=1e-15)
    assert reports == pytest.approx([11.0, 12.0])


@pytest.mark.slow
def test_feedback_without_delay_is_no_algebraic_loop(fmu: Callable[..., Path]) -> None:
    """Position -> command -> acceleration: each slave feels the other, no output itself."""
    commands = [f"cmd_{i}" for i in range(1, 5)]
    system = System(
        {"airframe": fmu("no_lag"), "height": fmu("height")},
        connect("height", "airframe", commands) + connect("airframe", "height", ["pos_z"]),
        {"airframe.initial.pos_z": -9.5, "airframe.initial.vel_z": 1.0},
    )
    record = ["airframe.pos_z", "airframe.vel_z", "height.cmd_1", "airframe.specific_force_z"]
    plant = airframe(load_vehicle("feisi_x150"))
    with Master(system, record) as master:
        master.initialize()
        run = master.run(20 * H, H, "settled")
    np.testing.assert_allclose(run["height.cmd_1"], 0.4 + 0.05 * (run["airframe.pos_z"] + 9.0))
    assert np.ptp(run["height.cmd_1"]) > 1e-4
    forces = []
    for pos_z, vel_z, cmd, _ in run.values:
        p = plant.parameter_values({"initial.pos_z": pos_z, "initial.vel_z": vel_z})
        u = plant.input_values(dict.fromkeys(commands, cmd))
        x = np.asarray(plant.initial(u, p), dtype=np.float64).ravel()
        outputs = dict(zip(plant.output_names, np.asarray(plant.outputs(x, u, p)), strict=True))
        forces.append(float(outputs["specific_force_z"][0]))
    np.testing.assert_allclose(run["airframe.specific_force_z"], forces, rtol=1e-12)


def test_replay_drives_the_airframe(fmu: Callable[..., Path], tmp_path: Path) -> None:
    """FMI 3 beside FMI 2, Boolean outputs recorded as 0 and 1."""
    time = np.arange(100) / 100
    table = pd.DataFrame({"time": time} | {f"cmd_{i}": 0.8 + time / 10 for i in range(1, 5)})
    names = tuple(f"cmd_{i}" for i in range(1, 5))
    replay = build(replay_model(Flight("ramp", table), names), tmp_path / "replay.fmu", 3)
    system = System(
        {"replay": replay, "airframe": fmu("airframe")}, connect("replay", "airframe", names)
    )
    with Master(system, ["replay.cmd_1", "replay.valid.cmd_1", "airframe.rotor_1"]) as master:
        master.initialize()
        run = master.run(1.2, 0.01, "gauss_seidel")
    np.testing.assert_array_equal(run["replay.cmd_1"][:100], 0.8 + time / 10)
    assert set(run["replay.valid.cmd_1"][:100]) == {1.0}
    assert run["replay.valid.cmd_1"][-1] == 0.0
    assert run["airframe.rotor_1"][-1] > run["airframe.rotor_1"][0] + 50


# -- recording ------------------------------------------------------------------------------


def test_recordings_keep_every_bit(system: System, tmp_path: Path) -> None:
    with Master(system) as master:
        master.initialize()
        run = master.run(30 * H, H)
    for name, read in (("r.csv", pd.read_csv), ("r.parquet", pd.read_parquet)):
        run.write(tmp_path / name)
        back = read(tmp_path / name)
        assert list(back.columns) == ["time", *run.names]
        assert back["time"].to_numpy().tobytes() == run.time_s.tobytes()
        assert np.ascontiguousarray(back[list(run.names)].to_numpy()).tobytes() == (
            run.values.tobytes()
        )
    with pytest.raises(FmuError, match=r"r\.xlsx: recordings are written as \.parquet or \.csv"):
        run.write(tmp_path / "r.xlsx")


def test_chosen_columns_in_the_order_asked(system: System) -> None:
    names = ["imu.gyro_x", "airframe.pos_z", "imu.acc_z"]
    with Master(system, names) as few, Master(system) as all_:
        few.initialize()
        all_.initialize()
        a, b = few.run(20 * H, H), all_.run(20 * H, H)
    assert a.names == tuple(names)
    assert all(a[n].tobytes() == b[n].tobytes() for n in names)


# -- refusals -------------------------------------------------------------------------------

WRONG: dict[str, tuple[Mapping[str, Any], str]] = {
    "unknown slave": (
        {"connections": (Connection("airfame.pos_x", "imu.omega_x"),)},
        r"'airfame\.pos_x': there is no slave 'airfame'; the system has airframe, imu\. Did you "
        r"mean 'airframe'\?",
    ),
    "no variable": (
        {"connections": (Connection("airframe", "imu.omega_x"),)},
        r"'airframe': there is no slave .* Names are slave\.variable",
    ),
    "unknown source": (
        {"connections": (Connection("airframe.omga_x", "imu.omega_x"),)},
        r"airframe2\.fmu: there is no variable 'omga_x'\. Did you mean 'omega_x'\?",
    ),
    "unknown target": (
        {"connections": (Connection("airframe.omega_x", "imu.omegax"),)},
        r"imu2\.fmu: there is no variable 'omegax'\. Did you mean 'omega_x'\?",
    ),
    "units": (
        {"connections": (Connection("airframe.pos_x", "imu.omega_x"),)},
        r"airframe\.pos_x \[m\] -> imu\.omega_x \[rad/s\]: units differ",
    ),
    "two sources": (
        {
            "connections": (
                Connection("airframe.omega_x", "imu.omega_x"),
                Connection("airframe.omega_y", "imu.omega_x"),
            )
        },
        r"imu\.omega_x has two sources; an input takes one",
    ),
    "direction": (
        {"connections": (Connection("imu.omega_x", "airframe.omega_x"),)},
        r"imu\.omega_x \(input\) -> airframe\.omega_x \(output\): .* from an output to an input",
    ),
    "start value of no variable": (
        {"starts": {"imu.seeed": 1.0}},
        r"imu2\.fmu: there is no variable 'seeed'\. Did you mean 'seed'\?",
    ),
    "start value of nobody": (
        {"starts": {"gps.mass": 1.0}},
        r"'gps\.mass': there is no slave 'gps'",
    ),
    "period of nobody": ({"periods": {"gps": 2}}, r"period of 'gps' = 2: needs a slave"),
    "period": ({"periods": {"imu": 0}}, r"period of 'imu' = 0: .* an integer >= 1"),
}


@pytest.mark.parametrize("case", WRONG)
def test_wrong_systems_are_refused(system: System, case: str) -> None:
    changes, message = WRONG[case]
    with pytest.raises(FmuError, match=message):
        Master(replace(system, **changes))


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("airframe.mas", 1.0, r"airframe2\.fmu: there is no variable 'mas'\. Did you mean 'mass'"),
        ("airframe.pos_x", 1.0, r"pos_x is an output; only parameters and inputs"),
        ("airframe.mass", -1.0, r"airframe \(airframe2\.fmu\): start values: mass = -1 is below"),
        ("imu.omega_x", np.nan, r"imu \(imu2\.fmu\): start values: omega_x = -?nan"),
    ],
)
def test_wrong_start_values_are_refused(
    system: System, name: str, value: float, message: str
) -> None:
    with Master(system) as master:
        with pytest.raises(FmuError, match=message):
            master.initialize(starts={name: value})
        master.initialize()  # and the next attempt works
        master.run(H, H)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((1.0, 0.0), r"communication step 0 s must be positive"),
        ((1.0, -0.1), r"communication step -0\.1 s must be positive"),
        ((1.0, np.nan), r"communication step nan s must be positive"),
        ((1.0, 0.3), r"from 0 s to 1 s is not a whole number of steps of 0\.3 s"),
        ((-1.0, 0.1), r"from 0 s to -1 s is not a whole number of steps"),
        ((np.nan, 0.1), r"stop time nan s must be a finite number"),
        ((np.inf, 0.1), r"stop time inf s must be a finite number"),
        ((1.0, 0.1, "euler"), r"algorithm 'euler': choose jacobi, settled, gauss_seidel"),
        ((1.0, 0.1, "jacobi", 0), r"every = 0: record every so many steps"),
    ],
)
def test_wrong_runs_are_refused(
    system: System, arguments: tuple[float, float], message: str
) -> None:
    with Master(system, ["imu.acc_x"]) as master:
        with pytest.raises(FmuError, match=r"call initialize\(\) before run"):
            master.run(1.0, 0.1)
        master.initialize()
        with pytest.raises(FmuError, match=message):
            master.run(*arguments)


def test_unknown_column_is_refused(system: System) -> None:
    with pytest.raises(FmuError, match=r"no variable 'gyro_'\. Did you mean 'gyro_.'"):
        Master(system, ["imu.gyro_"])


def test_divergence_names_slave_state_and_time(system: System) -> None:
    with Master(system) as master:
        master.initialize(starts={"airframe.initial.omega_y": 1e160})
        with pytest.raises(
            FmuError,
            match=r"airframe \(airframe2\.fmu\): step at 0 s: state .*nan at time 0\.001 s",
        ):
            master.run(1.0, H)


def test_files_that_are_no_fmus(tmp_path: Path, fmu: Callable[..., Path]) -> None:
    text = tmp_path / "text.fmu"
    text.write_text("no zip")
    with pytest.raises(FmuError, match=r"text\.fmu: not a readable FMU"):
        Master(System({"a": text}))
    with pytest.raises(FmuError, match=r"missing\.fmu: not a readable FMU"):
        Master(System({"a": tmp_path / "missing.fmu"}))


# -- what is left behind --------------------------------------------------------------------


@pytest.fixture
def temp(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder for temporary files that nobody else writes to."""
    folder = tmp_path / "temp"
    folder.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(folder))
    return folder


def mapped() -> int:
    return Path("/proc/self/maps").read_text().count("/uavtwin-")


def test_failed_loads_leave_nothing(fmu: Callable[..., Path], tmp_path: Path, temp: Path) -> None:
    """A library that does not load, and a GUID that the library refuses."""

    def changed(name: str, suffix: str, old: bytes, new: bytes) -> Path:
        with zipfile.ZipFile(fmu("imu")) as good, zipfile.ZipFile(tmp_path / name, "w") as bad:
            for member in good.namelist():
                content = good.read(member)
                if member.endswith(suffix):
                    assert old in content
                    content = content.replace(old, new)
                bad.writestr(member, content)
        return tmp_path / name

    here, maps = Path.cwd(), mapped()
    broken = changed("broken.fmu", ".so", b"\x7fELF", b"\x7fELG")
    with pytest.raises(FmuError, match=r"broken\.fmu: cannot be loaded: Failed to load shared"):
        Master(System({"good": fmu("airframe"), "a": broken}))
    other = changed("other.fmu", ".xml", b'guid="', b'guid="0')
    with pytest.raises(FmuError, match=r"other\.fmu: cannot be loaded: GUID does not match"):
        Master(System({"good": fmu("airframe"), "a": other}))
    assert (Path.cwd(), mapped()) == (here, maps)
    assert not list(temp.iterdir())


@pytest.mark.slow
def test_closing_frees_folders_libraries_and_files(system: System, temp: Path) -> None:
    def instantiate(times: int) -> None:
        for _ in range(times):
            with Master(system) as master:
                master.initialize()
                master.run(2 * H, H)

    instantiate(2)  # what is loaded once and for all
    files, maps = len(os.listdir("/proc/self/fd")), mapped()
    instantiate(150)  # 300 FMUs
    assert len(os.listdir("/proc/self/fd")) == files
    assert mapped() == maps
    assert not list(temp.iterdir())
    master = Master(system)
    assert len(list(temp.iterdir())) == 2
    master.close()
    master.close()  # twice does no harm
    assert not list(temp.iterdir())


def test_fmi2_slaves_get_all_callbacks(system: System) -> None:
    """Ours need no memory of the master, other people's FMUs call for it."""
    with Master(system) as master:
        for slave in master.slaves:
            callbacks = slave._fmu.callbacks
            assert callbacks.logger
            assert callbacks.allocateMemory
            assert callbacks.freeMemory
