"""The wheel alone, on a machine without a C compiler: what `pip install uavtwin` gives."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from places import ROOT

from fmus.builder import cache_folder
from twin.logs.table import write_flight
from twin.vehicle_file import load_vehicle
from uavtwin.demo.flights import fly

PACKAGES = ("uavtwin", "twin", "learning", "fmus", "cosim")
pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder with the packages of the wheel; dependencies are those of the tests."""
    folder = tmp_path_factory.mktemp("wheel")
    pip = (sys.executable, "-m", "pip", "--disable-pip-version-check", "--quiet")
    build = (*pip, "wheel", "--no-deps", "--no-build-isolation", "--wheel-dir", folder, ROOT)
    subprocess.run(build, check=True)
    (wheel,) = folder.glob("uavtwin-*.whl")
    subprocess.run((*pip, "install", "--no-deps", "--target", folder / "site", wheel), check=True)
    return folder / "site"


def run(site: Path, work: Path, *arguments: object) -> str:
    """What a verb of the wheel prints, on a path without compilers and with a cache that holds
    nothing but zig's own libraries, which take a minute to compile."""
    where = f"import {', '.join(PACKAGES)}; print({', '.join(f'{p}.__file__' for p in PACKAGES)})"
    empty = work / "bin"
    cache = work / "cache"
    for folder in (empty, cache):
        folder.mkdir(exist_ok=True)
    if not (cache / "zig").exists():
        (cache_folder() / "zig").mkdir(parents=True, exist_ok=True)
        (cache / "zig").symlink_to((cache_folder() / "zig").absolute())
    environment = {
        **{k: v for k, v in os.environ.items() if k not in ("CC", "PYTHONPATH")},
        "PATH": str(empty),
        "PYTHONPATH": str(site),
        "UAVTWIN_CACHE": str(cache),
    }
    verb = "from uavtwin.cli.main import main; main()"
    for code, given in ((where, ()), (verb, arguments)):
        command = (sys.executable, "-P", "-c", code, *map(str, given))
        result = subprocess.run(
            command, cwd=work, env=environment, capture_output=True, text=True, check=False
        )
        assert result.returncode in (0, 1), result.stderr
        if code == where:
            assert all(Path(p).is_relative_to(site) for p in result.stdout.split())
    return result.stdout


def test_its_verbs_need_no_compiler(installed: Path, tmp_path: Path) -> None:
    vehicle = load_vehicle("copter_default")
    flight = tmp_path / "flight.parquet"
    write_flight(fly(vehicle, vehicle, seed=1), flight)
    run(installed, tmp_path, "check", flight, "--json")
    assert json.loads(run(installed, tmp_path, "why", flight, "--json"))["events"] == []
    run(installed, tmp_path, "gap", flight, "--vehicle", "copter_default", "--out", "gap")
    assert "</html>" in (tmp_path / "gap" / "report.html").read_text("utf-8")


def test_it_compiles_with_zig_which_it_brings(installed: Path, tmp_path: Path) -> None:
    import fmpy

    run(installed, tmp_path, "export", "imu", "--vehicle", "copter_default", "--out", "fmus")
    fmu = min((tmp_path / "fmus").glob("*.fmu"))
    result = fmpy.simulate_fmu(str(fmu), stop_time=0.1)
    assert len(result) > 1
