"""Many FMUs in one process: none hears of another, and none leaves anything behind."""

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from instance import Instance, unzip
from kinds import component
from places import IMPORT_PATH, needs

from fmus import build, component_model
from twin.component import Component, ComponentBuilder

CYCLES = 10_000
WARM_UP = 500

PROGRAM = """
import sys
from pathlib import Path
from instance import Instance
instances = [Instance(Path(folder)).start() for folder in sys.argv[1:]]
for k in range(300):
    for instance in instances:
        instance.step(k * 1e-3)
for instance in instances:
    print(instance.outputs().tobytes().hex())
"""


def outputs(*folders: Path) -> list[str]:
    """Outputs of extracted FMUs, loaded into a new process in this order and stepped in turn."""
    result = subprocess.run(
        [sys.executable, "-c", PROGRAM, *map(str, folders)],
        env={**os.environ, "PYTHONPATH": IMPORT_PATH},
        capture_output=True,
        text=True,
        check=True,
    )
    return result.stdout.split()


def other_battery() -> Component:
    """Another component of the same name, with the same variables."""
    original = component("battery")
    m = ComponentBuilder(original.name, original.description)
    for v in original.parameters:
        m.parameter(v.name, v.start, v.unit, v.description, minimum=v.minimum, maximum=v.maximum)
    current = m.input("ibat_a", "A", "Current", original.inputs[0].start)
    charge = m.state("charge", "1", "Charge", 0.8)
    m.derivative("charge", -current / 100)
    m.output("charge", "1", "Charge", charge)
    m.output("vbat_v", "V", "Voltage", 7 + charge**2)
    return m.build()


@pytest.mark.slow
def test_versions_of_one_component_do_not_meet(tmp_path: Path) -> None:
    """Other start values, another equation, another FMI version: each gives what it gives alone."""
    battery = component("battery")
    versions = [
        (battery, 2),
        (battery.with_starts({"resistance": 0.3, "initial.charge": 0.5}), 2),
        (other_battery(), 2),
        (other_battery().with_starts({"ibat_a": 1.0}), 3),
    ]
    folders = [
        unzip(build(component_model(c), tmp_path / f"{i}.fmu", fmi), tmp_path / f"{i}")
        for i, (c, fmi) in enumerate(versions)
    ]
    alone = [outputs(folder)[0] for folder in folders]
    assert len(set(alone)) == len(alone)
    assert outputs(*folders, *folders) == alone + alone
    assert outputs(*reversed(folders)) == alone[::-1]


@pytest.mark.slow
@needs(Path("/proc/self/statm").exists(), "counts by /proc")
@pytest.mark.parametrize("fmi", [2, 3])
def test_instances_leave_nothing_behind(fmu_folder: Callable[[str, int], Path], fmi: int) -> None:
    """Instantiated, started, stepped and freed again and again."""
    instance = Instance(fmu_folder("fused", fmi))

    def cycle() -> None:
        instance.start()
        instance.step(0.0)
        free = getattr(instance.fmu, f"fmi{fmi}FreeInstance")
        free(instance.fmu.component)
        instance.instantiate()

    def used() -> tuple[int, int]:
        """Resident pages and open files."""
        pages = int(Path("/proc/self/statm").read_text().split()[1])
        return pages, len(os.listdir("/proc/self/fd"))

    for _ in range(WARM_UP):
        cycle()
    pages, files = used()
    for _ in range(CYCLES):
        cycle()
    after, open_files = used()
    instance.close()
    assert after < 1.05 * pages
    assert open_files == files
