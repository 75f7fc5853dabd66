"""modelDescription.xml: other people's checkers, units, descriptions, dependencies."""

import logging
import re
import subprocess
import sysconfig
import zipfile
from collections.abc import Callable
from pathlib import Path

import fmpy
import numpy as np
import pint
import pytest
from fmpy.validation import validate_fmu
from fmu_manipulation_toolbox.checker import get_checkers
from fmu_manipulation_toolbox.cli.utils import ErrorCounter
from fmu_manipulation_toolbox.operations import FMU
from instance import Instance
from kinds import ALL, component
from lxml import etree

FmuFile = Callable[[str, int], Path]
New = Callable[[str, int], Instance]
FMUTOOL = Path(sysconfig.get_path("scripts"), "fmutool")
CHECK_FAILED = 7  # fmu_manipulation_toolbox.cli.utils.ExitCode


def fmutool(path: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [FMUTOOL, "-input", path, "-check"], capture_output=True, text=True, check=False
    )


@pytest.mark.parametrize(("kind", "fmi"), ALL)
def test_fmpy_finds_no_problem(fmu_file: FmuFile, kind: str, fmi: int) -> None:
    assert validate_fmu(str(fmu_file(kind, fmi))) == []


@pytest.mark.parametrize(("kind", "fmi"), ALL)
def test_fmutool_finds_no_problem(fmu_file: FmuFile, kind: str, fmi: int) -> None:
    """Its Python API in this process; the command itself below, twice."""
    logger, errors = logging.getLogger("fmu_manipulation_toolbox"), ErrorCounter()
    logger.addHandler(errors)
    try:
        with FMU(str(fmu_file(kind, fmi))) as fmu:
            for checker in get_checkers():
                fmu.apply_operation(checker())
    finally:
        logger.removeHandler(errors)
    assert errors.count == 0


@pytest.mark.parametrize("fmi", [2, 3])
def test_fmutool_command_tells_good_from_bad(fmu_file: FmuFile, tmp_path: Path, fmi: int) -> None:
    good, bad = fmu_file("airframe-copter_default", fmi), tmp_path / "bad.fmu"
    with zipfile.ZipFile(good) as source, zipfile.ZipFile(bad, "w") as target:
        for name in source.namelist():
            content = source.read(name)
            if name == "modelDescription.xml":
                content = content.replace(b'initial="calculated"', b'initial="exact"')
            target.writestr(name, content)
    result = fmutool(good)
    assert result.returncode == 0, result.stderr
    assert fmutool(bad).returncode == CHECK_FAILED


@pytest.mark.parametrize(("kind", "fmi"), ALL)
def test_every_variable_has_description_and_defined_unit(
    fmu_file: FmuFile, kind: str, fmi: int
) -> None:
    description = fmpy.read_model_description(str(fmu_file(kind, fmi)))
    units = {u.name: u.baseUnit for u in description.unitDefinitions}
    for v in description.modelVariables:
        assert v.description and v.description[0].isupper(), v.name
        assert not v.description.endswith("."), v.name
        real = v.type in ("Real", "Float64")
        assert v.unit in units if real else v.unit is None, (v.name, v.unit)


@pytest.mark.parametrize("kind", sorted({kind for kind, _ in ALL}))
def test_si_exponents_are_the_dimension_of_the_unit(fmu_file: FmuFile, kind: str) -> None:
    """Pint reads the unit's name, FMI tools its exponents: both must mean the same."""
    registry: pint.UnitRegistry[float] = pint.UnitRegistry()
    for fmi in (2, 3):
        with zipfile.ZipFile(fmu_file(kind, fmi)) as archive:
            root = etree.fromstring(archive.read("modelDescription.xml"))
        definitions = root.findall("UnitDefinitions/Unit")
        assert definitions
        for unit in definitions:
            base = dict(unit[0].attrib)
            declared = registry.Quantity(1.0)
            for symbol, exponent in base.items():
                declared *= registry.Quantity(1.0, symbol) ** int(exponent)
            meant = registry.Quantity(1.0, pint_text(unit.get("name")))
            ratio = (meant / declared).to_base_units()
            # A radian is a number to pint, and a hertz is 1/s to FMI.
            assert ratio.dimensionless, (unit.get("name"), base)
            assert ratio.magnitude in (1.0, pytest.approx(1.0)), (unit.get("name"), base)
            assert ("rad" in base) == ("rad" in unit.get("name")), unit.get("name")


def pint_text(unit: str) -> str:
    """`kg.m2/rad2` as pint writes it: `kg*m**2/rad**2`."""
    return re.sub(r"(?<=[a-zA-Z])(\d)", r"**\1", unit.replace(".", "*").replace("Ohm", "ohm"))


@pytest.mark.parametrize("fmi", [2, 3])
def test_nominal_and_display_unit_of_everything_with_a_unit(fmu_file: FmuFile, fmi: int) -> None:
    """Angles are shown in degrees, 180 of them to pi; a usual size is near the start value."""
    description = fmpy.read_model_description(str(fmu_file("imu", fmi)))
    shown = {
        u.name: {d.name: float(d.factor) for d in u.displayUnits}
        for u in description.unitDefinitions
    }
    assert shown["rad/s"] == {"deg/s": pytest.approx(180 / np.pi, rel=1e-15)}
    real = [v for v in description.modelVariables if v.unit and v.name != "time"]
    assert len(real) > 20
    for v in real:
        nominal = float(v.nominal)
        assert nominal > 0, v.name
        if v.start is not None and float(v.start):
            assert nominal <= abs(float(v.start)) * (1 + 1e-9) < 10 * nominal * (1 + 1e-8), v.name
        assert (v.displayUnit is not None) == bool(shown[v.unit]), v.name


def test_the_default_step_keeps_the_times_round(fmu_file: FmuFile) -> None:
    """FMPy takes it for the interval of its rows, and doubles it until there are 1000 at most."""
    result = fmpy.simulate_fmu(str(fmu_file("battery", 2)), output=["vbat_v"])
    np.testing.assert_allclose(result["time"], np.arange(1001) * 0.01, atol=1e-12)


# -- dependencies ---------------------------------------------------------------------------

PROBED = [
    "airframe-feisi_x150",
    "airframe-copter_default",
    "airframe-crazyflie",
    "airframe-rotor_speed",
    "imu",
    "imu-filtered",
    "battery",
]


def declared(path: Path, group: str) -> dict[str, set[str]]:
    description = fmpy.read_model_description(str(path))
    return {u.variable.name: {k.name for k in u.dependencies} for u in getattr(description, group)}


def random_starts(kind: str, rng: np.random.Generator) -> dict[str, float]:
    """Every parameter and input off its start value, at times standing in the ground."""
    starts = {}
    for v in component(kind).parameters + component(kind).inputs:
        if v.boolean:
            starts[v.name] = float(rng.integers(2))
            continue
        value = v.start * rng.uniform(0.7, 1.3) + (
            0.1 * rng.standard_normal() if not v.start else 0
        )
        low = -np.inf if v.minimum is None else v.minimum
        high = np.inf if v.maximum is None else v.maximum
        starts[v.name] = float(np.clip(value, low, high))
    for name in starts:
        if name.startswith("inertia.") and name[-1] != name[-2]:
            starts[name] = 1e-6 * rng.standard_normal()  # small, so that it stays invertible
        if name.startswith(("wind", "initial.vel", "initial.omega")):
            starts[name] = rng.standard_normal()
    if "seed" in starts:
        starts["seed"] = float(rng.integers(100))
    if "ground.enabled" in starts and rng.random() < 0.7:
        starts["ground.enabled"] = 1.0
        starts["initial.pos_z"] = starts["ground.z"]  # the feet are a leg's length in the ground
    return starts


def nudged(kind: str, name: str, value: float) -> float:
    if name == "seed":
        return value + 1
    variable = next(v for v in component(kind).variables if v.name == name)
    if variable.boolean:
        return 1.0 - value
    step = 0.01 * abs(value) or 0.01
    return value - step if variable.maximum is not None else value + step


def changed(instance: Instance, kind: str, name: str, value: float, before: object) -> set[str]:
    """Outputs that move when one variable does, nothing else happening."""
    instance.set({name: nudged(kind, name, value)})
    after = instance.outputs()
    instance.set({name: value})
    moved = after != np.asarray(before)
    return {n for n, hit in zip(instance.output_names, moved, strict=True) if hit}


@pytest.mark.parametrize("fmi", [2, 3])
@pytest.mark.parametrize("kind", PROBED)
def test_dependencies_are_exact(fmu_file: FmuFile, new: New, kind: str, fmi: int) -> None:
    """Outputs move with the declared inputs and with no other."""
    rng = np.random.default_rng(7)
    instance, seen = new(kind, fmi), set()
    for _ in range(8):
        starts = random_starts(kind, rng)
        instance.fmu.reset()
        instance.start(starts)
        instance.step(0.0)
        before = instance.outputs()
        for name in component(kind).input_names:
            seen |= {(y, name) for y in changed(instance, kind, name, starts[name], before)}
    told = declared(fmu_file(kind, fmi), "outputs")
    assert set(told) == set(instance.output_names)
    assert seen == {(y, u) for y, inputs in told.items() for u in inputs}


@pytest.mark.parametrize("fmi", [2, 3])
@pytest.mark.parametrize("kind", PROBED)
def test_initial_unknowns_are_exact(fmu_file: FmuFile, new: New, kind: str, fmi: int) -> None:
    """The same at initialisation, where parameters and initial values count as well."""
    rng = np.random.default_rng(11)
    instance, seen = new(kind, fmi), set()
    for _ in range(12):
        starts = random_starts(kind, rng)
        instance.fmu.reset()
        instance.enter(starts)
        before = instance.outputs()
        for name, value in starts.items():
            seen |= {(y, name) for y in changed(instance, kind, name, value, before)}
    told = declared(fmu_file(kind, fmi), "initialUnknowns")
    pairs = {(y, u) for y, knowns in told.items() for u in knowns}
    assert set(told) == set(instance.output_names)
    assert seen <= pairs
    # A constant torque cancels between rotors that turn either way: in the equations, not felt.
    assert {u for _, u in pairs - seen} <= {"torque.c0"}
