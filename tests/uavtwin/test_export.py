"""`uavtwin export`: every component and the whole twin, listed truly, with nothing to complain."""

import hashlib
import zipfile
from dataclasses import replace
from pathlib import Path

import fmpy
import numpy as np
import pytest
from checker_rig import problems
from cli_rig import run
from fmpy.validation import validate_fmu
from importer_rig import STEP_S, STEPS, in_process_of
from numpy.typing import NDArray

from cosim.interface import read_interface
from cosim.master import Master
from cosim.ssp import read_ssp, write_ssp
from twin.errors import TwinError
from twin.flight.assembly import COMPONENTS
from twin.vehicle_file import load_vehicle
from uavtwin.cli.export import Choice, export_components
from uavtwin.cli.options import COMPONENT_NAMES
from uavtwin.exports.parts import component
from uavtwin.exports.write import WrittenFile

Array = NDArray[np.float64]
PLATFORM = {2: "binaries/linux64", 3: "binaries/x86_64-linux"}
CASES = [(name, fmi) for name in (*COMPONENTS, "corrected_twin") for fmi in (2, 3)]


def test_the_command_line_names_every_component() -> None:
    assert COMPONENT_NAMES.split(", ") == list(COMPONENTS)


@pytest.fixture(scope="module")
def exported(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[WrittenFile]]:
    """Everything of the Crazyflie, FMI 2 and 3, and the list of it."""
    folder = tmp_path_factory.mktemp("exported")
    choice = Choice("crazyflie", "2,3", mission="tour")
    shares: list[float] = []
    rows = export_components((*COMPONENTS, "corrected-twin"), choice)(folder, shares.append)
    assert shares == sorted(shares)
    assert shares[-1] == 1.0
    return folder, rows


@pytest.mark.slow
def test_lists_what_it_wrote(exported: tuple[Path, list[WrittenFile]]) -> None:
    folder, rows = exported
    files = {p.relative_to(folder).as_posix() for p in folder.rglob("*") if p.is_file()}
    wanted = {f"fmi{fmi}/{name}.fmu" for name, fmi in CASES}
    wanted |= {f"fmi{fmi}/corrected_twin.ssp" for fmi in (2, 3)}
    assert {row.file for row in rows} == files == wanted
    for row in rows:
        content = (folder / row.file).read_bytes()
        assert row.bytes == len(content)
        assert row.sha256 == hashlib.sha256(content).hexdigest()
        assert row.platforms == ("linux64",)
        assert row.file.startswith(f"fmi{row.fmi}/")


@pytest.mark.slow
@pytest.mark.parametrize(("name", "fmi"), CASES)
def test_checkers_find_no_problem(
    exported: tuple[Path, list[WrittenFile]], name: str, fmi: int
) -> None:
    assert problems(exported[0] / f"fmi{fmi}" / f"{name}.fmu") == []


@pytest.mark.parametrize(("name", "fmi"), CASES)
def test_every_variable_has_unit_and_description(
    exported: tuple[Path, list[WrittenFile]], name: str, fmi: int
) -> None:
    path = exported[0] / f"fmi{fmi}" / f"{name}.fmu"
    description = fmpy.read_model_description(str(path))
    units = {u.name for u in description.unitDefinitions}
    for v in description.modelVariables:
        assert v.description and not v.description.endswith("."), v.name
        real = v.type in ("Real", "Float64")  # the standards give units to these alone
        assert v.unit in units if real else v.unit is None, (v.name, v.unit)
    with zipfile.ZipFile(path) as archive:
        assert any(n.startswith(PLATFORM[fmi]) for n in archive.namelist())
        assert any(n.startswith("sources/") for n in archive.namelist())


@pytest.mark.slow
@pytest.mark.parametrize("name", COMPONENTS)
def test_no_input_is_ignored(name: str) -> None:
    """By the sparsity of all that a component computes."""
    c = component(name, load_vehicle("crazyflie"))
    felt = [(c.outputs, 1), (c.derivatives, 1), (c.initial, 0)]
    if c.sampling is not None:
        felt += [(c.sampling.update, 1), (c.sampling.signals, 1)]
    columns = {k for f, argument in felt for k in f.jac_sparsity(0, argument).get_triplet()[1]}
    assert columns == set(range(len(c.inputs)))


@pytest.mark.parametrize("name", COMPONENTS)
def test_a_component_that_says_where_its_derivatives_jump_is_for_solvers(name: str) -> None:
    """The ground is such a place, so the airframe is the one of ours."""
    made = component(name, load_vehicle("crazyflie"))
    assert made.for_solvers is (name == "airframe")
    assert not replace(made, continuous=None).for_solvers


def test_command_line(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    arguments = ("battery", "mission", "--vehicle", "crazyflie", "--mission", "land")
    code, said, _ = run(capsys, "export", *arguments, "--out", tmp_path)
    assert code == 0
    lines = said.splitlines()
    assert lines[0].startswith("battery.fmu  FMI 2  linux64  ")
    assert (
        lines[1]
        == f"  sha256 {hashlib.sha256((tmp_path / 'battery.fmu').read_bytes()).hexdigest()}"
    )
    description = fmpy.read_model_description(str(tmp_path / "mission.fmu"))
    assert description.description == "Mission land for crazyflie"


@pytest.mark.slow
def test_start_values_of_the_whole_twin(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Baked into the fused FMU and into the FMUs of the `.ssp`; descriptions alone are read."""
    monkeypatch.setattr("fmus.builder.compile_library", lambda *_: b"")
    monkeypatch.setattr("uavtwin.exports.write.add_reference_results", lambda *_: None)
    starts = ["airframe.mass=0.03", "imu.seed=4", "mission.wait=0.5"]
    choice = Choice("crazyflie", start=starts, mission="tour", position="mocap")
    export_components(["corrected-twin"], choice)(tmp_path, lambda _: None)
    whole = read_interface(tmp_path / "corrected_twin.fmu").description
    values = {v.name: v.start for v in whole.modelVariables}
    system = read_ssp(tmp_path / "corrected_twin.ssp")
    for part, path in system.fmus.items():
        for v in read_interface(path).description.modelVariables:
            assert v.causality == "input" or v.start == values[f"{part}.{v.name}"]
    assert [float(values[s.split("=")[0]]) for s in starts] == [0.03, 4.0, 0.5]
    sensor = tuple(read_interface(system.fmus["position"]).names("output"))
    assert sensor == component("position", load_vehicle("crazyflie"), position="mocap").output_names
    assert {f"position.{name}" for name in sensor} <= values.keys()
    assert "meas_q_w" in sensor


@pytest.mark.slow
@pytest.mark.parametrize("fmi", [2, 3])
def test_real_outputs_are_the_numbers_of_the_typed_ones(tmp_path: Path, fmi: int) -> None:
    """For importers that read every output by fmi2GetReal: truth values are 0 and 1, enumerations
    their codes. Parameters and inputs keep their types."""
    runs = []
    for outputs in ("typed", "real"):
        choice = Choice("crazyflie", fmi=str(fmi), outputs=outputs)
        export_components(["mission"], choice)(tmp_path / outputs, lambda _: None)
        path = tmp_path / outputs / "mission.fmu"
        assert validate_fmu(str(path)) == []
        variables = fmpy.read_model_description(str(path)).modelVariables
        kinds = {
            c: {v.type for v in variables if v.causality == c} for c in ("parameter", "output")
        }
        assert (kinds["output"] == {"Real" if fmi == 2 else "Float64"}) == (outputs == "real")
        run = fmpy.simulate_fmu(str(path), stop_time=3.0, output_interval=0.1)
        runs.append(np.column_stack([run[n].astype(float) for n in run.dtype.names or ()]))
    np.testing.assert_array_equal(runs[0], runs[1])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("names", "choice", "text"),
    [
        (("airfame",), Choice(), "Did you mean 'airframe'?"),
        (("corrected_twin",), Choice(), "Did you mean 'corrected-twin'?"),
        (("imu",), Choice(fmi="1"), "--fmi 1: choose 2, 3 or 2,3"),
        (("imu",), Choice(platform="vax"), "vax"),
        (("imu",), Choice(vehicle="crazyfly"), "crazyfly"),
        (("mission",), Choice(mission="tuor"), "tuor"),
        (("position",), Choice(position="gps"), "Did you mean 'gnss'?"),
        (("corrected-twin",), Choice(controller="lqg"), "Did you mean 'lqr'?"),
        (("corrected-twin",), Choice(start=["mass=1"]), "there is no parameter or input 'mass'"),
        (("corrected-twin",), Choice(start=["airframe.mass=-1"]), "outside its range"),
        (("battery",), Choice(vehicle="copter_default"), "[battery]"),
        (("replay",), Choice(), "--flight"),
        (("imu",), Choice(outputs="Real"), "--outputs Real: choose typed or real"),
        (("imu",), Choice(outputs="real", python_slave=True), "leave out the Python slave"),
        (("imu",), Choice(drive="commands"), "nothing of imu: it goes with airframe and corr"),
        (("imu", "airframe"), Choice(mission="tour"), "it goes with mission and corrected-twin."),
        (("airframe",), Choice(controller="px4"), "it goes with corrected-twin."),
        (("airframe",), Choice(position="mocap"), "it goes with position and corrected-twin."),
        (("airframe",), Choice(linear="pos_x"), "--linear pos_x: changes nothing of airframe: it"),
        (("airframe",), Choice(flight=Path("a.ulg")), "goes with replay."),
        (("corrected-twin",), Choice(drive="commands", controller="px4"), "--drive mission."),
        (("corrected-twin",), Choice(drive="commands", mission="tour"), "--drive mission."),
    ],
)
def test_wrong_use(names: tuple[str, ...], choice: Choice, text: str) -> None:
    with pytest.raises(TwinError) as refused:
        export_components(names, choice)
    assert text in str(refused.value)


# -- the .ssp in other tools ----------------------------------------------------------------

STATES = (
    "airframe.pos_z",
    "airframe.vel_x",
    "airframe.q_y",
    "airframe.omega_y",
    "battery.vbat_v",
    "battery.charge",
    "environment.wind_x",
    "position.meas_pos_z",
    "mission.setpoint_pos_z",
)
FELT = ("environment.density", "imu.gyro_y", "magnetometer.mag_x", "barometer.baro_pa")
"""Outputs that depend directly on the airframe's states."""
CHAINED = ("airframe.specific_force_x", "airframe.ibat_a", "imu.acc_x", "controller.cmd_1")
NAMES = (*STATES, *FELT, *CHAINED)


@pytest.fixture(scope="module")
def ssp(exported: tuple[Path, list[WrittenFile]], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The exported `.ssp` with wind, gusts and noise, taking off at once."""
    system = read_ssp(exported[0] / "fmi2" / "corrected_twin.ssp")
    starts = {
        "mission.wait": 0.1,
        "environment.wind.x": 4.0,
        "environment.gust.enabled": 1.0,
        "environment.seed": 3.0,
        "airframe.rotor_drag.enabled": 1.0,
        "imu.acc_noise": 0.1,
    }
    path = tmp_path_factory.mktemp("ssp") / "windy.ssp"
    return write_ssp(replace(system, starts=starts), path)


@pytest.fixture(scope="module")
def ours(ssp: Path) -> Array:
    """By `jacobi`, from the second row on, shape (STEPS + 1, n)."""
    with Master(read_ssp(ssp), NAMES) as master:
        master.initialize()
        recording = master.run((STEPS + 1) * STEP_S, STEP_S)
    assert np.ptp(recording["airframe.pos_z"]) > 0.3  # it flies
    assert np.ptp(recording["battery.vbat_v"]) > 0.3  # and draws current
    return recording.values[1:]


@pytest.mark.slow
def test_the_whole_twin_in_libcosim(ssp: Path, ours: Array, tmp_path: Path) -> None:
    """The numbers of `jacobi`; their steps are 1 ms but for the last bit."""
    theirs = in_process_of("libcosimpy", tmp_path / "values.npy", str(ssp), *NAMES)
    span = np.ptp(ours, axis=0)
    assert np.max(np.abs(theirs - ours[:STEPS]) / span) < 1e-10


@pytest.mark.slow
def test_the_whole_twin_in_ecos(ssp: Path, ours: Array, tmp_path: Path) -> None:
    """What is stepped is that of `jacobi` to the last bit; what is felt is shown at once, which
    `jacobi` does a step later; what has come through two parts is between the two."""
    theirs = in_process_of("ecospy", tmp_path / "values.npy", str(ssp), *NAMES)
    columns = dict(zip(NAMES, range(len(NAMES)), strict=True))
    stepped, felt = [columns[n] for n in STATES], [columns[n] for n in FELT]
    assert theirs[:, stepped].tobytes() == ours[:STEPS, stepped].tobytes()
    assert theirs[:, felt].tobytes() == ours[1:, felt].tobytes()
