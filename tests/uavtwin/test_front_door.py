"""`import uavtwin`: the five minutes of the README for real, light to import, errors that help."""

import ast
import io
import json
import os
import pkgutil
import re
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping
from dataclasses import fields, is_dataclass, replace
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from cli_rig import run as run_uavtwin
from sample_logs import flight_table, foreign

import uavtwin as ut
from cosim.ssp import read_ssp
from fmus import component_model
from twin import vehicle_file as vehicle_files
from twin.logs import write_flight
from uavtwin import ExplainResult, FleetResult, GapResult, SweepResult
from uavtwin.demo.flights import Waypoints, fly
from uavtwin.display import PageMixin
from uavtwin.file_check import CheckReport

COPTER = ut.load_vehicle("copter_default")
DRAG_1_S = 0.5
PLANT = replace(
    COPTER,
    drag_linear_n_s_m=COPTER.drag_linear_n_s_m
    + DRAG_1_S * COPTER.mass_kg * np.array([1.0, 1.0, 0.0]),
)
PACKAGES = ("twin", "learning", "fmus", "cosim", "uavtwin")
HEAVY = ("casadi", "fmpy", "numpy", "pandas", "torch", "scipy", "plotly", "pyarrow")
Place = tuple[float, float, float]


def legs(*places: Place) -> Waypoints:
    """Take off, then each place in 2 s."""
    start: Waypoints = (("ground", 0.5, (0.0, 0.0, 0.0)), ("takeoff", 3.0, (0.0, 0.0, -1.0)))
    return (*start, *(("forward", 2.0, place) for place in places))


ACROSS, BACK, AWAY = (2.0, 1.0, -1.0), (-1.0, 2.0, -1.2), (3.0, -1.0, -1.0)
FLIGHTS = {
    "fit_1": legs(ACROSS, BACK, AWAY),
    "fit_2": legs(BACK, ACROSS, AWAY, BACK),
    "other": legs(BACK, AWAY, ACROSS),
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three flights of a plant with more drag than `mine.toml` says."""
    folder = tmp_path_factory.mktemp("five_minutes")
    for seed, (name, waypoints) in enumerate(FLIGHTS.items(), start=1):
        write_flight(fly(COPTER, PLANT, seed, name, waypoints), folder / f"{name}.parquet")
    text, _ = vehicle_files.vehicle_text("copter_default")
    (folder / "mine.toml").write_text(text.replace("[body]", "[body]  # as weighed"))
    return folder


# -- five minutes ---------------------------------------------------------------------------

SNIPPET = """
import uavtwin as ut
vehicle = ut.load_vehicle("mine.toml")
fit, held = ut.read_flights("fit_*.parquet"), ut.read_flights("other.parquet")
gap = ut.gap(fit[0], vehicle); print(gap)
found = ut.explain(fit, held, vehicle); print(found)
found.report("out.html"); found.vehicle.save("better.toml")
ut.export(ut.twin(found.vehicle), "twin.fmu", fmi=(2, 3), starts={"airframe.mass": 1.6})
run = ut.simulate("tour", found.vehicle, wind=(5, 0, 0)); plot = run.frame().plot()
"""


@pytest.fixture(scope="module")
def names(folder: Path) -> Iterator[dict[str, Any]]:
    """What the snippet leaves, and what it printed; one mission is flown at the end, not five."""
    names: dict[str, Any] = {}
    stdout, before = io.StringIO(), Path.cwd()
    with pytest.MonkeyPatch.context() as patch, pd.option_context("plotting.backend", "plotly"):
        patch.setattr("twin.flight.closed_loop.mission_names", lambda: ("takeoff",))
        patch.setattr(sys, "stdout", stdout)
        os.chdir(folder)
        try:
            exec(SNIPPET, names)
        finally:
            os.chdir(before)
    yield names | {"printed": stdout.getvalue()}


@pytest.mark.slow
def test_the_snippet_says_what_was_found(names: dict[str, Any]) -> None:
    printed = names["printed"]
    assert re.search(r"^Twin and flight disagree most in acc_[xy]", printed, re.MULTILINE)
    assert re.search(r"^acc_x +m/s² +0 +\d+", printed, re.MULTILINE)
    assert re.search(r"^Missing from the model: rotor drag 0\.(48|49|50)", printed, re.MULTILINE)
    assert re.search(r"^rotor drag +.* %.*k_xy_1_s +0\.(48|49|50)", printed, re.MULTILINE)
    assert "noise floor" in printed


@pytest.mark.slow
def test_the_better_vehicle_is_the_file_with_the_effect(
    folder: Path, names: dict[str, Any]
) -> None:
    found, text = names["found"], (folder / "better.toml").read_text()
    assert text.startswith((folder / "mine.toml").read_text())
    saved = ut.load_vehicle(folder / "better.toml")
    assert saved.effects == found.vehicle.effects
    assert saved.effects["rotor_drag"]["k_xy_1_s"] == pytest.approx(DRAG_1_S, rel=0.03)
    source = saved.sources["effects.rotor_drag.k_xy_1_s"]
    assert source.startswith("uavtwin explain, fit_1 and fit_2, 95 % interval 0.4")
    assert found.vehicle_before.effects == {}


@pytest.mark.slow
def test_results_are_tables_pages_and_json(folder: Path, names: dict[str, Any]) -> None:
    gap, found, run = names["gap"], names["found"], names["run"]
    page = (folder / "out.html").read_text("utf-8")
    assert "<h1>Missing from the model: rotor drag" in page
    for result in (gap, found, run):
        json.dumps(result.json(), allow_nan=False)
        html = result._repr_html_()
        assert html.count("<table>") == html.count("</table>") >= 1
        assert len(repr(result)) < 300
    assert found.candidates().set_index("number")["value"]["k_xy_1_s"] == pytest.approx(
        found.json()["effects"][0]["parameters"]["k_xy_1_s"]["value"], rel=1e-5
    )
    frame = found.frame().set_index("channel")
    assert frame["after"]["acc_x"] < 0.5 * frame["before"]["acc_x"]
    # The plot has the time on its axis and a line per output.
    plot = names["plot"]
    assert len(plot.data) == run.frame().shape[1]
    assert plot.data[0].x[-1] == pytest.approx(run.recording.time_s[-1])


@pytest.mark.slow
def test_the_exported_twin_has_the_start_value(folder: Path, names: dict[str, Any]) -> None:
    from fmpy import read_model_description

    for fmi in (2, 3):
        description = read_model_description(str(folder / f"fmi{fmi}" / "twin.fmu"))
        starts = {v.name: v.start for v in description.modelVariables}
        assert description.fmiVersion.startswith(str(fmi))
        assert float(starts["airframe.mass"]) == 1.6
        assert starts["airframe.rotor_drag.enabled"] == "true"


@pytest.mark.slow
def test_python_and_the_command_line_say_the_same(
    folder: Path, names: dict[str, Any], capsys: pytest.CaptureFixture[str]
) -> None:
    out = folder / "cli"
    arguments = (folder / "fit_1.parquet", "--vehicle", folder / "mine.toml", "--out", out)
    code, _, _ = run_uavtwin(capsys, "gap", *arguments)
    assert code == 0
    assert json.loads((out / "gap.json").read_text()) == names["gap"].json()
    names["gap"].report(folder / "gap.html")
    assert (out / "report.html").read_bytes() == (folder / "gap.html").read_bytes()


# -- results, quickly -----------------------------------------------------------------------


@pytest.fixture(scope="module")
def gap(folder: Path) -> ut.GapResult:
    return ut.gap(ut.read_flights(folder / "fit_*.parquet"), ut.load_vehicle(folder / "mine.toml"))


@pytest.mark.slow
def test_the_gap_as_a_frame_and_as_samples(gap: ut.GapResult) -> None:
    frame = gap.frame().set_index(["channel", "phase"])
    content = gap.json()["channels"]
    assert set(frame.index.get_level_values(0)) == set(content)
    assert frame.loc[("acc_x", "whole flight"), "rms"] == content["acc_x"]["rms"]
    assert frame.loc[("acc_x", "forward"), "n"] == content["acc_x"]["by_phase"]["forward"]["n"]
    samples = gap.residuals()
    own = samples[(samples["channel"] == "acc_x") & (samples["horizon_s"] == 0)]
    assert set(own["flight"]) == {"fit_1", "fit_2"}
    np.testing.assert_allclose(own["residual"], own["measured"] - own["simulated"])
    rms = np.sqrt(np.mean(own["residual"] ** 2))
    assert rms == pytest.approx(content["acc_x"]["rms"], rel=1e-12)


def test_the_gap_as_text_and_in_a_notebook(gap: ut.GapResult) -> None:
    claim, *others = str(gap).split("\n\n")
    assert claim == gap.claim
    hover, (table, *warnings) = others[: len(gap.hover)], others[len(gap.hover) :]
    assert hover == [*gap.hover] and len({text[:6] for text in hover}) == len(hover) > 0
    header, *rows = table.splitlines()
    assert header.split("  ")[0] == "channel"
    assert len({row.index("m/s²") for row in rows if "m/s²" in row}) == 1  # columns are straight
    assert "\n".join(warnings) == "\n".join(gap.warnings)
    html = gap._repr_html_()
    assert html.count("<tr>") == len(rows) + 1
    escaped = replace(gap, flights=(replace(gap.flights[0], warnings=("a < b",)),))
    assert "a &lt; b" in escaped._repr_html_()
    assert repr(gap) == "<GapResult: 2 flights against copter_default, 18 channels>"


@pytest.fixture(scope="module")
def run() -> ut.Run:
    return ut.simulate(
        "takeoff",
        ut.vehicle("crazyflie"),
        wind=(3, 0, 0),
        effects={"rotor_drag": {"k_xy_1_s": 0.5}},
        starts={"mission.wait": 0.1},
        duration=6,
    )


@pytest.mark.slow
def test_a_run_is_shaped_by_objects(run: ut.Run) -> None:
    """Leaning against the wind as the drag asks for."""
    lean = 2 * np.arcsin(run["airframe.q_y"][-1])
    assert lean == pytest.approx(np.arctan(0.5 * 3.0 / 9.80665), rel=0.05)
    frame = run.frame()
    assert frame.index.name == "time"
    assert frame.index[-1] == pytest.approx(6.0)
    assert run.units["airframe.vel_x"] == "m/s"
    assert str(run).startswith("takeoff: 6 s flown, ")
    with pytest.raises(ut.TwinError, match=r"Did you mean 'airframe\.pos_z'"):
        run["airframe.posz"]


@pytest.mark.slow
def test_a_run_is_saved_and_reported(run: ut.Run, tmp_path: Path) -> None:
    path = run.save(tmp_path / "new" / "run.parquet")
    pd.testing.assert_frame_equal(pd.read_parquet(path).set_index("time"), run.frame())
    page = run.report(tmp_path / "run.html").read_text("utf-8")
    assert "<dt>wind</dt><dd>3,0,0</dd>" in page
    with pytest.raises(ut.TwinError, match=r"recordings are written as \.parquet or \.csv"):
        run.save(tmp_path / "run.xlsx")
    assert not (tmp_path / "run.xlsx").exists()


@pytest.mark.slow
def test_a_system_is_exported_and_run(tmp_path: Path) -> None:
    """The `.ssp` is the scenario: the same numbers to the last bit."""
    vehicle = ut.vehicle("crazyflie")
    written = ut.export(ut.twin(vehicle, "takeoff"), tmp_path / "crazy.ssp")
    assert written.paths == (tmp_path / "crazy.ssp",)
    assert set(read_ssp(written.paths[0]).fmus) == set(ut.twin(vehicle).assembly.parts)
    own = ut.simulate(written.paths[0], duration=1.0)
    scenario = ut.simulate("takeoff", vehicle, duration=1.0)
    pd.testing.assert_frame_equal(own.frame(), scenario.frame(), check_exact=True)


def test_parts_are_exported_one_by_one(folder: Path, tmp_path: Path) -> None:
    from fmpy import read_model_description

    vehicle, flight = ut.vehicle("crazyflie"), ut.read_flight(folder / "other.parquet")
    (tmp_path / "b.fmu").write_text("an old file is replaced")
    (tmp_path / "precious.txt").write_text("mine")
    part = ut.component("battery", vehicle)
    battery = ut.export(part, tmp_path / "b.fmu", starts={"resistance": 0.25})
    replay = ut.export(ut.replay(flight, linear=["pos_x"]), tmp_path / "replay.fmu", fmi=3)
    starts = {v.name: v.start for v in read_model_description(battery.paths[0]).modelVariables}
    assert float(starts["resistance"]) == 0.25
    assert read_model_description(replay.paths[0]).fmiVersion == "3.0"
    assert (tmp_path / "precious.txt").read_text() == "mine"
    assert "sha256" in str(battery) and battery.files[0].sha256 in str(battery)


# -- as a value -----------------------------------------------------------------------------


def _values(value: Any, seen: set[int], depth: int = 0) -> Iterator[Any]:
    """Every dataclass that can be reached from a value."""
    if id(value) in seen or depth > 12:
        return
    seen.add(id(value))
    if isinstance(value, CheckReport):
        yield value
    elif is_dataclass(value) and not isinstance(value, type):
        yield value
        for f in fields(value):
            yield from _values(getattr(value, f.name), seen, depth + 1)
    elif isinstance(value, Mapping):
        for one in value.values():
            yield from _values(one, seen, depth + 1)
    elif isinstance(value, list | tuple):
        for one in value[:20]:
            yield from _values(one, seen, depth + 1)


@pytest.fixture(scope="module")
def values(folder: Path, gap: ut.GapResult, run: ut.Run) -> list[Any]:
    """A result of every function, and what they hold."""
    vehicle, flight = (
        ut.load_vehicle(folder / "mine.toml"),
        ut.read_flight(folder / "other.parquet"),
    )
    twin = ut.twin(vehicle.with_effects({n: e.starts(vehicle) for n, e in ut.EFFECTS.items()}))
    flights = [flight, replace(flight, facts={f"fact {i}": "x" * 300 for i in range(20)})]
    checked = ut.check(folder / "mine.toml")
    models = [component_model(part) for part in twin.assembly.parts.values()]
    found = ut.explain(flight, [], vehicle, missions=("takeoff",))
    roots = (gap, run, vehicle, twin, flights, checked, models, ut.replay(flight), found)
    return list(_values(roots, set()))


@pytest.mark.slow
def test_every_value_is_shown_in_a_few_lines(values: list[Any]) -> None:
    shown = {type(v): repr(v) for v in sorted(values, key=lambda v: len(repr(v)))}
    long = {t.__name__: len(text) for t, text in shown.items() if len(text) > 300}
    assert not long
    names = {t.__name__ for t in shown}
    assert names >= {
        "Assembly",
        "Channel",
        "CheckReport",
        "Comparison",
        "Component",
        "ExplainResult",
        "Explanation",
        "Fit",
        "Flight",
        "FlightGap",
        "FmuModel",
        "GapResult",
        "Naming",
        "Problem",
        "Recording",
        "Rotors",
        "Run",
        "Sampling",
        "Sensors",
        "Submodel",
        "Twin",
        "Vehicle",
    }


def test_a_value_says_what_it_is() -> None:
    vehicle = ut.vehicle("crazyflie")
    assert repr(vehicle).startswith("Vehicle(name='crazyflie', description='Bitcraze Crazyflie")
    assert "inertia_kg_m2=<ndarray 3x3>" in repr(vehicle)
    assert vehicle.text not in repr(vehicle)


# -- wrong use ------------------------------------------------------------------------------


def _vehicle() -> ut.Vehicle:
    return ut.vehicle("crazyflie")


WRONG: dict[str, tuple[Callable[[Path], object], str]] = {
    "crazyfly": (lambda _: ut.vehicle("crazyfly"), "Did you mean 'crazyflie'?"),
    "no such file": (lambda _: ut.load_vehicle("mein.toml"), "neither a vehicle file nor"),
    "pattern": (lambda f: ut.read_flights(f / "fit_*.ulg"), "no flight matches this pattern"),
    "near": (lambda f: ut.read_flights(f / "other.parqet"), "Did you mean 'other.parquet'?"),
    "no folder": (lambda f: ut.read_flights(f / "logs" / "*.ulg"), "There is no folder"),
    "nothing": (lambda _: ut.read_flights(), "no file and no pattern given"),
    "a name": (lambda _: ut.gap("one.ulg", _vehicle()), "'one.ulg' is the name of a file"),  # type: ignore[arg-type]
    "names": (lambda _: ut.explain(["one.ulg"], [], _vehicle()), "read_flights(PATTERN)"),  # type: ignore[list-item]
    "a number": (lambda _: ut.gap(3, _vehicle()), "a int is no flight"),  # type: ignore[arg-type]
    "text": (lambda f: ut.gap(_other(f), "crazyflie"), "the text 'crazyflie'. Give a vehicle"),  # type: ignore[arg-type]
    "twice": (lambda f: ut.explain(_other(f), _other(f), _vehicle()), "hold out others"),
    "none": (lambda f: ut.explain([], _other(f), _vehicle()), "no flight to fit on"),
    "payload": (
        lambda f: ut.explain(_other(f), [], _vehicle(), payloads={"othr": 0.2}),
        "payload: there is no flight 'othr'. Did you mean 'other'?",
    ),
    "negative": (
        lambda f: ut.explain(_other(f), [], _vehicle(), payloads={"other": -0.2}),
        "payload of other = -0.2 kg",
    ),
    "mission": (lambda _: ut.simulate("tuor", _vehicle()), "neither an .ssp file nor a scenario"),
    "wind": (lambda _: ut.simulate("tour", _vehicle(), wind=(1, 2)), "give three numbers"),  # type: ignore[arg-type]
    "one wind": (
        lambda _: ut.simulate("tour", _vehicle(), wind=5),  # type: ignore[arg-type]
        "wind = 5: give three numbers",
    ),
    "effect": (lambda _: ut.simulate("tour", _vehicle(), effects="drag"), "there is no effect"),
    "number": (
        lambda _: ut.simulate("tour", _vehicle(), effects={"rotor_drag": {"k_xy": 1.0}}),
        "Did you mean 'rotor_drag.k_xy_1_s'?",
    ),
    "component": (lambda _: ut.component("airfame", _vehicle()), "Did you mean 'airframe'?"),
    "column": (lambda f: ut.replay(_other(f), ["pos"]), "there is no column 'pos'"),
    "fmi": (lambda f: ut.export(ut.twin(_vehicle()), f / "t.fmu", fmi=1), "choose 2, 3 or (2, 3)"),
    "suffix": (lambda f: ut.export(ut.twin(_vehicle()), f / "t.zip"), "written as .fmu or .ssp"),
    "start": (
        lambda f: ut.export(ut.twin(_vehicle()), f / "t.fmu", starts={"airframe.mas": 1.0}),
        "Did you mean 'airframe.mass'?",
    ),
    "what": (lambda f: ut.export(_vehicle(), f / "t.fmu"), "a Vehicle cannot be exported"),  # type: ignore[arg-type]
    "platform": (
        lambda f: ut.export(ut.twin(_vehicle()), f / "t.fmu", platforms=["win46"]),
        "Did you mean 'win64'?",
    ),
}


def _other(folder: Path) -> ut.Flight:
    return ut.read_flight(folder / "other.parquet")


@pytest.mark.slow
@pytest.mark.parametrize("case", WRONG)
def test_wrong_use_is_told_in_terms_of_python(folder: Path, case: str) -> None:
    call, text = WRONG[case]
    with pytest.raises(ut.TwinError) as refused:
        call(folder)
    assert text in str(refused.value)
    assert "--" not in str(refused.value)
    assert not list(folder.glob("t.*"))


def test_flights_come_in_the_order_that_people_count(folder: Path, tmp_path: Path) -> None:
    flight = pd.read_parquet(folder / "other.parquet")
    for k, name in enumerate(("fit_10", "fit_2", "fit_1")):
        flight.iloc[k:].to_parquet(tmp_path / f"{name}.parquet")
    patterns = (tmp_path / "fit_*.parquet", tmp_path / "fit_2.parquet")
    assert [f.name for f in ut.read_flights(*patterns)] == ["fit_1", "fit_2", "fit_10"]


def test_a_failed_report_leaves_the_old_one(
    gap: ut.GapResult, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    def fail(_: object, path: Path, *__: object) -> None:
        path.write_text("half")
        raise KeyboardInterrupt

    path = tmp_path / "gap.html"
    path.write_text("old")
    monkeypatch.setattr("uavtwin.display.PageMixin.draw", fail)
    with pytest.raises(KeyboardInterrupt):
        gap.report(path)
    assert path.read_text() == "old"
    assert [p.name for p in tmp_path.iterdir()] == ["gap.html"]


# -- names ----------------------------------------------------------------------------------


def _typed_names() -> set[str]:
    """Names that a type checker sees: those under `if TYPE_CHECKING`."""
    tree = ast.parse(Path(str(ut.__file__)).read_text("utf-8"))
    block = next(
        n for n in tree.body if isinstance(n, ast.If) and ast.unparse(n.test) == "TYPE_CHECKING"
    )
    found: set[str] = set()
    for node in block.body:
        if isinstance(node, ast.ImportFrom):
            found |= {a.asname or a.name for a in node.names}
        elif isinstance(node, ast.AnnAssign):
            found.add(ast.unparse(node.target))
    return found


def test_every_name_is_there_and_typed() -> None:
    assert _typed_names() == set(ut.__all__) == set(dir(ut))
    for name in ut.__all__:
        assert getattr(ut, name) is not None
        assert name == "EFFECTS" or name == "__version__" or getattr(ut, name).__doc__, name
    assert re.fullmatch(r"\d+\.\d+\.\d+.*", ut.__version__)
    with pytest.raises(AttributeError, match="gapp"):
        ut.gapp  # type: ignore[attr-defined]  # noqa: B018


def test_no_name_is_that_of_a_module() -> None:
    """Importing the module would put it in the place of the name."""
    assert not {m.name for m in pkgutil.iter_modules(ut.__path__)} & set(ut.__all__)


def _loaded(code: str) -> set[str]:
    """Modules in memory after some code in a fresh interpreter."""
    ask = "import json, sys; print(json.dumps(sorted(sys.modules)))"
    result = subprocess.run(
        [sys.executable, "-c", f"{code}\n{ask}"],
        capture_output=True,
        text=True,
        check=True,
        cwd=Path(str(ut.__file__)).parents[1],
    )
    return set(json.loads(result.stdout.splitlines()[-1]))


HELP = """
import sys
from uavtwin.cli.main import main
sys.argv = ["uavtwin", *{words}]
try:
    main()
except SystemExit as stop:
    assert not stop.code
"""


@pytest.mark.slow
@pytest.mark.parametrize(
    "code",
    [
        "import uavtwin",
        "import uavtwin; dir(uavtwin); uavtwin.__version__; uavtwin.TwinError",
        HELP.format(words=["--help"]),
        HELP.format(words=["explain", "--help"]),
        HELP.format(words=["version"]),
    ],
    ids=["import", "version", "help", "help of a verb", "verb"],
)
def test_nothing_heavy_is_imported_before_it_is_used(code: str) -> None:
    assert not _loaded(code) & set(HEAVY)


@pytest.mark.parametrize("kind", [GapResult, ExplainResult, SweepResult, FleetResult, ut.Run])
def test_a_result_names_the_module_of_its_page(kind: type[PageMixin]) -> None:
    assert callable(import_module(kind.page).page_text)


@pytest.mark.slow
def test_naming_explain_loads_what_explaining_needs() -> None:
    """No FMU builder, no SSP, no pages, no files of series; few modules of ours."""
    loaded = _loaded("import uavtwin as ut; ut.explain")
    own = {m for m in loaded if m.partition(".")[0] in PACKAGES}
    others = ("fmus", "cosim", "learning", "uavtwin.report", "uavtwin.exports", "uavtwin.series")
    assert [m for m in own if m.startswith(others)] == []
    assert len(own) <= 135


@pytest.mark.slow
def test_a_machine_without_torch_can_name_all_and_is_told_what_to_install(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    assert "torch" not in _loaded("import uavtwin as ut; [getattr(ut, n) for n in ut.__all__]")
    monkeypatch.setitem(sys.modules, "uavtwin.compensators.evaluation", None)
    with pytest.raises(ut.TwinError, match=r"pip install .*'torch>="):
        ut.evaluate(tmp_path, [])


USER = """
import uavtwin as ut
vehicle = ut.load_vehicle("mine.toml")
fit = ut.read_flights("fit_*.ulg")
found = ut.explain(fit, [], vehicle)
reveal_type(found.vehicle.with_mass(1.0))
reveal_type(ut.gap(fit[0], vehicle).frame())
reveal_type(ut.export(ut.twin(found.vehicle), "twin.fmu", fmi=(2, 3)).paths)
reveal_type(ut.simulate("tour", found.vehicle, wind=(5, 0, 0))["airframe.pos_x"])
ut.gap(fit[0], "crazyflie")
ut.gapp
"""


@pytest.mark.slow
def test_a_type_checker_sees_it_all(tmp_path: Path) -> None:
    """With the settings and what is left of `make lint`, so that uavtwin is not read anew."""
    (tmp_path / "user.py").write_text(USER)
    result = subprocess.run(
        [sys.executable, "-m", "mypy", tmp_path / "user.py"],
        capture_output=True,
        text=True,
        cwd=Path(str(ut.__file__)).parents[1],
    )
    # By the name alone: the cache remembers the same text by the folder of its first run.
    told = [line for line in result.stdout.splitlines() if "user.py:" in line]
    for words, line in zip(
        (
            'Revealed type is "uavtwin.vehicles.Vehicle"',
            'Revealed type is "',  # of pandas, where that comes with types
            'Revealed type is "tuple[pathlib',
            'Revealed type is "numpy.ndarray',
            'incompatible type "str"; expected "Vehicle"',
            'has no attribute "gapp"',
        ),
        told,
        strict=False,
    ):
        assert words in line, result.stdout
    assert len(told) >= 6


@pytest.mark.slow
def test_commands_of_one_aircraft_are_read_in_one_way(data_dir: Path, tmp_path: Path) -> None:
    paths = [foreign(data_dir / "rflysimdt" / "real_1.ulg", tmp_path)]
    paths.append(data_dir / "rflysimdt" / "real_3.ulg")
    one, other = ut.read_flights(*paths)
    assert one.facts["commands"] == "actuator_outputs, 10 Hz"
    assert other.facts["commands"].startswith("actuator_outputs")
    assert any("those of foreign could not" in f.message for f in other.findings)
    _, other = ut.read_flights(*paths, rebuild_commands=True)
    assert other.facts["commands"].startswith("rebuilt")


def test_flights_of_one_name_are_told_apart_and_the_same_flight_is_refused(tmp_path: Path) -> None:
    first = flight_table()
    for place, shift in (("may/one", 0.0), ("may/two", 1e-3), ("june/one", 2e-3)):
        folder = tmp_path / place
        folder.mkdir(parents=True)
        first.assign(acc_x=first["acc_x"] + shift).to_parquet(folder / "log.parquet")
    names = [f.name for f in ut.read_flights(str(tmp_path / "**" / "*.parquet"))]
    assert sorted(names) == ["june/one/log", "may/one/log", "two/log"]
    copy = tmp_path / "copy.parquet"
    copy.write_bytes((tmp_path / "may" / "one" / "log.parquet").read_bytes())
    with pytest.raises(ut.TwinError, match=r"copy\.parquet: holds the same flight as"):
        ut.read_flights(tmp_path / "may" / "one" / "log.parquet", copy)


@pytest.mark.slow
def test_another_aircraft_is_told(data_dir: Path) -> None:
    folder = data_dir / "rflysimdt"
    one, two, other = ut.read_flights(*(folder / f"{n}.ulg" for n in ("real_1", "real_2", "sim_1")))
    assert not [x for f in (one, two) for x in f.findings if x.where == "aircraft"]
    (told,) = [x.message for x in other.findings if x.where == "aircraft"]
    assert "PX4_SITL" in told and "than real_1 (autopilot 0006" in told


def test_windows_is_refused_with_a_way_out() -> None:
    code = "import sys; sys.platform = 'win32'; import uavtwin"
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert found.returncode == 1 and "wsl --install" in found.stderr
