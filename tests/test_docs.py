"""Documentation says what the code says; every example and every TOML of it works."""

import importlib.util
import inspect
import json
import os
import re
import subprocess
import sys
from importlib import import_module
from pathlib import Path
from pkgutil import walk_packages

import pytest
from cli_rig import run

import uavtwin as ut
from twin.vehicle_file import parse_vehicle
from uavtwin.cli.main import VERBS
from uavtwin.cli.options import Prints
from uavtwin.cli.vehicle import vehicle as vehicle_app
from uavtwin.demo.flights import fly, hide
from uavtwin.record import Record, keys, schema

ROOT = Path(__file__).parents[1]


@pytest.mark.slow
def test_tables_are_generated_from_the_code(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.syspath_prepend(str(ROOT / "docs" / "_generate"))
    import tables

    stale = tables.main(check=True)
    assert not stale, capsys.readouterr().out + "run: python docs/_generate/tables.py"


@pytest.mark.slow
def test_figures_are_those_stored() -> None:
    result = subprocess.run(
        [sys.executable, ROOT / "docs" / "_generate" / "figures.py", "--check"],
        capture_output=True,
        text=True,
    )
    assert result.returncode == 0, result.stdout + "run: python docs/_generate/figures.py"


def test_measured_figures_take_the_place_of_stored_ones(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(ROOT / "docs" / "_generate"))
    import figures

    twice: list[figures.Figure] = [
        {"what": "a", "value": 1.0},
        {"what": "b", "value": None},
        {"what": "a", "value": 2.5},
    ]
    stored: list[figures.Figure] = [
        {"what": "both", "value": "old", "bench": ["a", "a (2)"], "form": "{0:.0f} to {1:.1f} us"},
        {"what": "skipped", "value": "old", "bench": ["a", "b"], "form": "{0}{1}"},
        {"what": "by hand", "value": "old"},
    ]
    assert figures.update(stored, figures.measured(twice)) == ["skipped"]
    assert [f["value"] for f in stored] == ["1 to 2.5 us", "old", "old"]


def _blocks() -> list[str]:
    pages = ("guide/vehicle.md", "reference/vehicle_fields.md")
    text = "\n".join((ROOT / "docs" / page).read_text("utf-8") for page in pages)
    return re.findall(r"```toml\n(.*?)```", text, re.DOTALL)


def test_the_vehicle_of_the_documentation_loads() -> None:
    example, commanded, *_ = _blocks()
    assert parse_vehicle(example, "example.toml").drive == "rotor_speed"
    assert parse_vehicle(example + commanded, "example.toml").drive == "command"


def test_every_polynomial_of_the_documentation_loads() -> None:
    example, _, variants, raw = _blocks()
    light = example.replace("value = 1.2,", "value = 0.03,")  # each map carries 30 g
    body = light.split("thrust_from_speed")[0]
    torque = 'torque_per_thrust = { value = 0.01, unit = "m", source = "x" }\n'
    maps = [line for line in variants.splitlines() if line.startswith("thrust")] + [raw]
    assert len(maps) == 5
    for text in maps:
        assert parse_vehicle(body + torque + text, "variant.toml").rotors.thrust_n


def test_deviations_and_effects_of_the_documentation_load() -> None:
    page = (ROOT / "docs" / "guide" / "vehicle.md").read_text("utf-8")
    known, effect = re.findall(r"```toml title=[^\n]*\n(.*?)```", page, re.DOTALL)
    whole = _blocks()[0]
    for line in known.splitlines():
        key = line.split(" = ")[0]
        whole = re.sub(rf"^{key} = .*$", line, whole, flags=re.MULTILINE)
    vehicle = parse_vehicle(f"{whole}\n{effect}", "example.toml")
    assert set(vehicle.deviations) == {
        "body.mass",
        "body.inertia",
        "effects.rotor_drag.k_xy_1_s",
    }


def _json_verbs() -> dict[str, Prints | None]:
    """What `--json` of each verb that has it prints."""
    found: dict[str, Prints | None] = {}
    for verb in (*VERBS, *(c.callback for c in vehicle_app.registered_commands)):
        assert verb is not None
        parameter = inspect.signature(verb).parameters.get("as_json")
        if parameter is not None:
            about = getattr(parameter.annotation, "__metadata__", ())
            found[verb.__name__] = next((a for a in about if isinstance(a, Prints)), None)
    return found


def test_every_verb_with_json_says_what_it_prints() -> None:
    """Behind `Json` in the type of its option; the reference is made of it."""
    verbs = _json_verbs()
    assert len(verbs) > 15
    assert [verb for verb, prints in verbs.items() if prints is None] == []


def test_every_record_stands_in_the_reference(monkeypatch: pytest.MonkeyPatch) -> None:
    """What a verb prints, what it leaves in a file, and what these hold."""
    monkeypatch.syspath_prepend(str(ROOT / "docs" / "_generate"))
    import tables

    for module in walk_packages(ut.__path__, "uavtwin."):
        if not module.name.endswith("__main__"):
            import_module(module.name)
    printed = {r.partition(":") for p in _json_verbs().values() if p is not None for r in p.records}
    shown = [*(getattr(import_module(m), c) for m, _, c in printed), *tables.FILES.values()]
    listed = {name for record in shown for name in schema(record)["$defs"]}
    every, left = set[str](), [Record]
    while left:
        own = [c for c in left.pop().__subclasses__() if c.__module__.startswith("uavtwin.")]
        every |= {c.__name__ for c in own}
        left += own
    assert len(every) > 50
    assert every - listed == {"Section"}


@pytest.mark.parametrize(
    "name", sorted({r for p in _json_verbs().values() if p is not None for r in p.records})
)
def test_every_key_of_json_is_documented(name: str) -> None:
    """Nested ones too: `keys` refuses a field that is not in the `Attributes:` of its class."""
    module, _, record = name.partition(":")
    content = getattr(import_module(module), record)
    listed = [k.path for k in keys(content)]
    assert len(listed) == len(set(listed)) > 0
    described = schema(content)["$defs"]
    assert all(p["description"] for d in described.values() for p in d["properties"].values())


def test_a_key_that_is_not_documented_is_found() -> None:
    class Inner(Record, frozen=True, kw_only=True):
        """Part.

        Attributes:
            known: Fine.
        """

        known: float
        new: float

    class Outer(Record, frozen=True, kw_only=True):
        """Whole.

        Attributes:
            parts: By name.
        """

        parts: dict[str, tuple[Inner, ...]]

    with pytest.raises(TypeError, match=r"Inner\.new"):
        list(keys(Outer))


def test_every_public_name_is_in_the_reference() -> None:
    page = (ROOT / "docs" / "reference" / "api.md").read_text("utf-8")
    shown = set(re.findall(r"^::: [\w.]+\.(\w+)$", page, re.MULTILINE))
    shown |= set(re.findall(r"`ut\.(\w+)`", page))
    assert {getattr(ut, n) for n in set(ut.__all__) - shown} <= {ut.check}
    assert "check_file" in shown


@pytest.mark.parametrize("page", ["README.md", "docs/reference/api.md"])
def test_names_of_the_front_door_exist(page: str) -> None:
    used = set(re.findall(r"\but\.(\w+)", (ROOT / page).read_text("utf-8")))
    assert used
    assert used <= set(ut.__all__), used - set(ut.__all__)


def test_links_of_the_files_at_the_top_lead_somewhere() -> None:
    """Those of `docs/` are checked by `make docs`."""
    for name in ("README.md", "CONTRIBUTING.md"):
        links = re.findall(r"\]\(([^)#:]+)[^):]*\)", (ROOT / name).read_text("utf-8"))
        assert links
        assert [link for link in links if not (ROOT / link).exists()] == []


QUESTIONS = {
    "where do I drop a log and read what happened": ("guide/serve", "no account, no vehicle file"),
    "does my log leave my machine": ("guide/serve", "Nothing leaves the machine"),
    "where are my flights kept": ("guide/serve", "the folder `uavtwin-store`"),
    "does the FMU compute at mine what it did at yours": ("reference/evidence", "uavtwin verify"),
    "who signed this FMU": ("reference/evidence", "minisign"),
    "does it run on Windows or a Mac": ("index", "use WSL 2"),
    "which settings must my autopilot log with": ("guide/log_formats", "SDLOG_PROFILE"),
    "I do not know the inertia of my aircraft": ("guide/own_log", "inertia 30 %"),
    "what is 0.8 m/s² in acc_x, and what do I do": ("guide/gap", "missing drag"),
    "it says 90 %: how sure is that name": ("guide/explain", "all candidate models"),
    "what does 'A (60 %) or B (30 %)' mean": ("guide/explain", "one of them is there"),
    "the answer is cannot_tell: what now": ("guide/explain", "fly `next_manoeuvre`"),
    "how do I fly the twin with my own controller": ("guide/fmus", "own_controller.py"),
    "what is the least that a log must contain for why": ("guide/why", "8 s in the air"),
    "how do I give the FMU motor commands of my own": ("guide/fmus", "own_commands.py"),
    "how does a controller that is an FMU fly the parts": (
        "guide/cosimulation",
        "own_controller_fmu.py",
    ),
    "how do I put the page of logs behind a proxy": ("guide/serve", "proxy_set_header Upgrade"),
    "what do I fly to tell a rotor from a load": ("guide/calibrate", "on the other side"),
    "what has changed since the last propellers": ("guide/calibrate", "`--since"),
    "how often is a name wrong": ("results/hidden_effects", "wrong"),
    "how long does an hour of log take, and how much memory": ("results/long_flights", "an hour"),
    "how do I look at the series in PlotJuggler": ("guide/series", "*Load Layout*"),
    "what does teacher-forced mean": ("reference/glossary", "teacher-forced"),
}
"""What a stranger asks: the page that answers, and words of the answer."""
CLICKS = 2
"""From the README to the answer, at most."""


def clicks_from_readme() -> dict[Path, int]:
    """Links to follow to each page."""
    found, queue = {ROOT / "README.md": 0}, [ROOT / "README.md"]
    for page in queue:
        for link in re.findall(r"\]\(([^)#:]+\.md)[^)]*\)", page.read_text("utf-8")):
            linked = (page.parent / link).resolve()
            if linked.exists() and linked not in found:
                found[linked] = found[page] + 1
                queue.append(linked)
    return found


def test_questions_of_a_stranger_have_an_answer_nearby() -> None:
    clicks = clicks_from_readme()
    for question, (page, words) in QUESTIONS.items():
        file = (ROOT / "docs" / f"{page}.md").resolve()
        assert clicks[file] <= CLICKS, question
        assert words in " ".join(file.read_text("utf-8").split()), question


def test_every_path_that_the_documents_name_is_there() -> None:
    """Folders and sources in the font of code; the pages on extending name what is to be made."""
    folders = "twin|learning|fmus|cosim|uavtwin|benchmarks|examples|tests|docs"
    path = re.compile(rf"`((?:{folders})/(?:[\w./-]*(?:/|\.(?:py|md|toml|c|h)))?)`")
    pages = [*(ROOT / "docs").rglob("*.md"), *ROOT.glob("*.md")]
    told = [p.read_text("utf-8") for p in pages if p.parent.name != "extending"]
    named = {m for text in told for m in path.findall(text)}
    assert len(named) > 50
    assert [name for name in sorted(named) if not (ROOT / name).exists()] == []


def test_every_page_that_the_code_names_is_there() -> None:
    """In messages, docstrings and comments, of vehicle files too."""
    sources = [
        f
        for folder in ("twin", "learning", "fmus", "cosim", "uavtwin", "benchmarks", "examples")
        for f in (ROOT / folder).rglob("*")
        if f.suffix in {".py", ".toml", ".ipynb", ".j2"}
    ]
    named = {m for f in sources for m in re.findall(r"docs/[\w/]+\.md", f.read_text("utf-8"))}
    assert len(named) > 10
    assert [name for name in sorted(named) if not (ROOT / name).exists()] == []


def test_pictures_are_small() -> None:
    """They travel with every clone."""
    tutorial = [p.stat().st_size for p in (ROOT / "docs/tutorial/pictures").iterdir()]
    assert sum(tutorial) < 200_000
    assert (ROOT / "docs/pictures/report.png").stat().st_size < 300_000


def test_the_drawings_are_those_of_the_generator(monkeypatch: pytest.MonkeyPatch) -> None:
    """And every room in them is a module."""
    monkeypatch.syspath_prepend(str(ROOT / "docs" / "_generate"))
    import drawings

    assert drawings.layers() == (drawings.PICTURES / "layers.svg").read_text("utf-8")
    assert drawings.flow() == (drawings.PICTURES / "data_flow.svg").read_text("utf-8")
    rooms = {room for layer in drawings.rooms() for room in layer}
    assert rooms == set(drawings.WORDS)
    assert [room for room in rooms if importlib.util.find_spec(room) is None] == []


@pytest.mark.slow
def test_the_tutorial_works(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Its blocks in order, as a reader would, on shorter flights; its words are about what comes
    out."""
    monkeypatch.syspath_prepend(str(ROOT / "docs" / "_generate"))
    import tutorial

    page = tutorial.PAGE.read_text("utf-8")
    whole, short = "fly(model, flown, seed, name, way)", "fly(model, flown, seed, name, way[:5])"
    assert whole in page
    printed = tutorial.run_blocks(page.replace(whole, short), tmp_path)
    shown = [b.body for b in tutorial.blocks(page) if b.language == "text"]
    assert len(printed) == len(shown)
    explained = json.loads((tmp_path / "explained" / "explain.json").read_text("utf-8"))
    found = explained["effects"][0]
    assert explained["verdict"] == "named"
    assert found["name"] == "mass_offset"
    assert found["parameters"]["mass_kg"]["value"] == pytest.approx(0.09, abs=0.002)
    sentence = re.compile(r"Missing from the model: [a-z ]+ ")
    named = [[m[0] for text in texts if (m := sentence.match(text))] for texts in (printed, shown)]
    assert named[0] == named[1] == ["Missing from the model: mass offset "]
    for place in re.findall(r"pictures/(\w+)\.png", page):
        assert (tmp_path / place / "report.html").is_file()


@pytest.mark.slow
def test_the_page_of_ones_own_log_works(
    capsys: pytest.CaptureFixture[str],
    data_dir: Path,
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
) -> None:
    """Its first two commands, on a recorded flight; `calibrate` has tests of its own."""
    page = (ROOT / "docs" / "guide" / "own_log.md").read_text("utf-8")
    for name, log in (("my_flight", "sim_1"), ("other", "sim_2")):
        recorded = data_dir / "rflysimdt" / f"{log}.ulg"
        (tmp_path / f"{name}.ulg").write_bytes(recorded.read_bytes())
    monkeypatch.chdir(tmp_path)
    lines = page.split("```sh\n")[1].split("```")[0].splitlines()
    verbs = [line.split()[1:] for line in lines]
    assert [v[0] for v in verbs] == ["check", "vehicle", "calibrate", "export"]
    code, said, _ = run(capsys, *verbs[0])
    assert code == 1  # it has gaps
    assert "hover            command 0.609" in said
    code, said, _ = run(capsys, *verbs[1])
    assert code == 0
    assert (tmp_path / verbs[2][verbs[2].index("--vehicle") + 1]).is_file()
    assert "hovers at command 0.609; the flights hover at 0.609" in said


@pytest.mark.slow
def test_the_python_of_the_readme_works(tmp_path: Path) -> None:
    """On shorter flights than those of the demo."""
    there = (("ground", 0.5, (0.0, 0.0, 0.0)), ("takeoff", 3.0, (0.0, 0.0, -1.0)))
    away, across = ("forward", 2.0, (3.0, 1.0, -1.0)), ("forward", 2.0, (-1.0, 2.0, -1.0))
    back = ("forward", 2.0, (0.0, 0.0, -1.3))
    ways = {
        "fit_1": (*there, away, back),
        "fit_2": (*there, across, away, back),
        "holdout": (*there, across, away, back),
    }
    vehicle = ut.vehicle("copter_default")
    plant = hide(vehicle, seed=4).plant
    (tmp_path / "demo" / "flights").mkdir(parents=True)
    for seed, (name, way) in enumerate(ways.items()):
        flight = fly(vehicle, plant, seed, name, way)
        ut.write_flight(flight, tmp_path / "demo" / "flights" / f"{name}.parquet")
    script = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text("utf-8"), re.DOTALL)
    result = subprocess.run(
        [sys.executable, "-c", "\n".join(script)], cwd=tmp_path, capture_output=True, text=True
    )
    assert result.returncode == 0, result.stderr
    assert "Missing from the model: rotor drag " in result.stdout
    assert "[effects.rotor_drag]" in (tmp_path / "better.toml").read_text("utf-8")
    assert (tmp_path / "explained.html").is_file()
    assert (tmp_path / "flight.html").is_file()
    assert (tmp_path / "twin.fmu").is_file()


SHORT = {
    "fly_tour_in_wind.py": ["3"],
    "fly_many.py": ["3"],
    "ab_effect.py": ["8"],
    "swap_controller.py": ["3"],
}
"""Arguments that make an example fly less than its reader wants."""
SAYS = {
    "five_minutes.py": r"disagree most in acc_(.|\n)*rotor drag 0\.(49|50)(.|\n)*twin\.fmu",
    "fly_many.py": r"0 m/s: 0\.\d+ m off(.|\n)*9 m/s: 0\.\d+ m off in the median flight, \d\.\d+ m",
    "fly_tour_in_wind.py": r"still air .* rms(.|\n)*5 m/s, gusts .* rms",
    "ab_effect.py": r"False: nose 0\.\d+ degrees up(.|\n)*True : nose [89]\.\d+ degrees up",
    "swap_controller.py": r"lqr  0\.\d+ m rms(.|\n)*px4  0\.\d+ m rms",
    "replay_and_twin.py": r"the twin is 0\.\d+ m off",
    "live_from_replay.py": r"Rotor 3 loses (1[89]|2[0-4]) % of its thrust at 1[56]\.",
    "replay_through_corrected_twin.py": r"15 times(.|\n)*pos +0\.1\d+ +0\.0\d+ m(.|\n)*omega +0\.0",
    "ecos_hover.py": r"100% of its mass: motor command 0\.\d+(.|\n)*110% .* command 0\.\d+",
    "libcosim_hover.py": r"wind of 0 m/s: nose -?0\.0 (.|\n)*3 m/s: nose [4-6]\.\d degrees down",
    "integrate_outside.py": r"1e-05: \d\.\de-0\d m(.|\n)*1e-10: \d\.\de-(0[7-9]|1\d) m apart",
    "own_commands.py": r" 10\.6 degrees(.|\n)*10\.0 s +1\d\.\d+ m",
    "own_controller_fmu.py": r"8\.0 s  1\.6\d+ m",
    "foreign_fmu.py": r"gust of 0 m/s: 0\.0\d+ m(.|\n)*gust of 8 m/s: 0\.[1-9]\d+ m",
}


LONG = {"five_minutes.py", "live_from_replay.py"}
"""Examples that repeat what the tests of the README's Python and of `live --demo` do."""
NEEDS_MODEL = {"compensate_with_onnxruntime.py"}
SCRIPTS = sorted(p.name for p in (ROOT / "examples").glob("*.py"))


@pytest.mark.slow
@pytest.mark.parametrize(
    "script", [pytest.param(s, marks=pytest.mark.long) if s in LONG else s for s in SCRIPTS]
)
def test_examples_run(script: str) -> None:
    result = subprocess.run(
        [sys.executable, "-W", "error", ROOT / "examples" / script, *SHORT.get(script, [])],
        capture_output=True,
        text=True,
        timeout=900,
    )
    if script in NEEDS_MODEL:  # with one: tests/learning/export
        assert result.returncode == 1 and "no model.onnx here" in result.stderr
    else:
        assert result.returncode == 0, result.stderr
        assert re.search(SAYS.get(script, r"\w"), result.stdout), result.stdout
    assert len((ROOT / "examples" / script).read_text().splitlines()) < 60


@pytest.mark.slow
def test_the_fmu_document_works(tmp_path: Path) -> None:
    """Blocks in order, as a reader would: shell commands, the Python script, the C program."""
    pages = ("guide/fmus.md", "method/fmus.md", "reference/fmu_importers.md")
    text = "\n".join((ROOT / "docs" / page).read_text("utf-8") for page in pages)
    script = ["set -eu"]
    for language, block in re.findall(r"```(sh|python|c)\n(.*?)```", text, re.DOTALL):
        if language == "sh":
            script.append(block)
        else:
            name = "main.c" if language == "c" else "main.py"
            script.append(f"cat > {name} <<'END OF FILE'\n{block}END OF FILE")
        if language == "python":
            script.append("python main.py")
    bin_folder = Path(sys.executable).parent
    result = subprocess.run(
        ["bash", "-c", "\n".join(script)],
        cwd=tmp_path,
        env={**os.environ, "PATH": f"{bin_folder}:{os.environ['PATH']}"},
        capture_output=True,
        text=True,
        timeout=900,
    )
    assert result.returncode == 0, result.stdout + result.stderr
    *lines, height = result.stdout.splitlines()
    (drift,) = (line for line in lines if "from the setpoint" in line)
    assert 0.05 < float(drift.split()[0]) < 0.5  # the wind is felt, and held against
    assert drift.endswith("m from the setpoint at worst")
    assert re.fullmatch(r"1\.[0-9]{3} m above the ground", height), height
    assert (tmp_path / "fmus_out" / "flight.csv").read_text().startswith('"time"')


@pytest.mark.slow
def test_the_system_of_the_page_on_co_simulation_runs(tmp_path: Path) -> None:
    """Its first blocks, as a reader would."""
    page = (ROOT / "docs" / "guide" / "cosimulation.md").read_text("utf-8")
    blocks = re.findall(r"```(sh|python)\n(.*?)```", page, re.DOTALL)[:3]
    assert [language for language, _ in blocks] == ["sh", "python", "sh"]
    bin_folder = Path(sys.executable).parent
    for language, block in blocks:
        subprocess.run(
            ["bash", "-ec", block] if language == "sh" else [sys.executable, "-c", block],
            cwd=tmp_path,
            env={**os.environ, "PATH": f"{bin_folder}:{os.environ['PATH']}"},
            check=True,
            capture_output=True,
        )
    assert (tmp_path / "run" / "report.html").is_file()


@pytest.mark.slow
@pytest.mark.parametrize("log", ["log10", "log15", "log16"])
def test_motor_delay_example_on_its_data(data_dir: Path, tmp_path: Path, log: str) -> None:
    source = data_dir / "crazyflie_motor_delay" / f"{log}.parquet"
    script = ROOT / "examples" / "crazyflie_motor_delay_to_flight_table.py"
    subprocess.run(
        [sys.executable, script, source, tmp_path / "flight.parquet"],
        check=True,
        capture_output=True,
    )
    assert (tmp_path / "flight.parquet").exists()


def test_readme_commands_exist() -> None:
    """Every `uavtwin VERB` that the README names is a verb."""
    from uavtwin.cli.main import app

    verbs = {c.name or c.callback.__name__ for c in app.registered_commands if c.callback}
    verbs |= {group.name for group in app.registered_groups if group.name}
    named = set(re.findall(r"uavtwin ([a-z]+)", (ROOT / "README.md").read_text()))
    assert named <= verbs | {"is", "as"}, named - verbs
