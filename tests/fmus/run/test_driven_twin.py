"""The twin that a log drives: its fused FMU against the airframe in Python, restarts included."""

from pathlib import Path

import fmpy
import numpy as np
import pytest
from instance import Array, Instance, unzip

from cosim.whole_twin import fused_model
from fmus import build
from twin.component import Run
from twin.flight.assembly import driven_twin
from twin.residuals.teacher_forced import RIGID
from twin.vehicle_file import load_vehicle
from uavtwin.cli.export import Choice, export_components

VEHICLE, H, STEPS = "crazyflie", 1e-3, 400
EFFECTS = ("rotor_drag", "command_delay")
RESTARTS = (5, 150, 151, 310)


@pytest.mark.slow
@pytest.mark.parametrize("fmi", [2, 3])
def test_fmu_flies_and_restarts_as_the_airframe_in_python(tmp_path: Path, fmi: int) -> None:
    """Commands that wander, a restart at some steps; air from the FMU's own environment."""
    twin = driven_twin(load_vehicle(VEHICLE), "command", EFFECTS)
    body = twin.parts["airframe"]
    path = build(fused_model(twin, VEHICLE), tmp_path / "twin.fmu", fmi)
    instance = Instance(unzip(path, tmp_path / "twin"))
    on = {"rotor_drag.enabled": 1.0, "command_delay.enabled": 1.0}
    instance.start({f"airframe.{k}": v for k, v in on.items()})
    inputs = {n: i for i, n in enumerate(body.input_names)}
    p, u = body.parameter_values(on), body.input_values()
    rng = np.random.default_rng(3)
    wander = 0.03 * np.cumsum(rng.normal(size=(STEPS, 4)), axis=0) / np.sqrt(STEPS)
    motion = np.hstack([rng.normal(size=(STEPS, 6)), rng.normal(size=(STEPS, 7))])
    air = [n for n in body.input_names if n.startswith(("wind_", "density"))]
    u[[inputs[n] for n in air]] = [instance.get(f"environment.{n}") for n in air]
    run, trim = Run(body, u, p), body.input_values()[:4]
    found: list[Array] = []
    expected: list[Array] = []
    for k in range(STEPS):
        now = dict(zip((f"cmd_{i}" for i in range(1, 5)), trim + wander[k], strict=True))
        now["restart"] = float(k in RESTARTS)
        now |= {f"restart.{s}": v for s, v in zip(RIGID, motion[k], strict=True)}
        now["restart.pos_z"] = -20.0
        instance.set({f"airframe.{n}": v for n, v in now.items()})
        u[[inputs[n] for n in now]] = list(now.values())
        u[[inputs[n] for n in air]] = [instance.get(f"environment.{n}") for n in air]
        instance.step(k * H)
        run.step(k * H, H, u)
        found.append(np.array([instance.get(f"airframe.{s}") for s in RIGID]))
        expected.append(run.outputs(u)[[body.output_names.index(s) for s in RIGID]])
        if k in RESTARTS:
            np.testing.assert_allclose(found[-1][:2], motion[k][:2], atol=1e-15)
    instance.close()
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-10)
    assert np.ptp(np.array(found)[:, 2]) > 10  # the restarts took it up


@pytest.mark.slow
def test_command_line_gives_it_inputs_and_no_pilot(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its description alone."""
    monkeypatch.setattr("fmus.builder.compile_library", lambda *_: b"")
    monkeypatch.setattr("uavtwin.exports.write.add_reference_results", lambda *_: None)
    choice = Choice(VEHICLE, drive="commands", start=["airframe.mass=0.03"])
    export_components(["corrected-twin"], choice)(tmp_path, lambda _: None)
    table = fmpy.read_model_description(str(tmp_path / "corrected_twin.fmu")).modelVariables
    by_name = {v.name: v for v in table}
    inputs = {n for n, v in by_name.items() if v.causality == "input"}
    assert {"airframe.cmd_1", "airframe.vbat_v", "airframe.force_x", "airframe.moment_z"} <= inputs
    assert by_name["airframe.restart"].type == "Boolean"
    assert {f"airframe.restart.{s}" for s in RIGID} <= inputs
    assert not any(n.startswith(("mission.", "controller.", "battery.")) for n in by_name)
    assert float(by_name["airframe.mass"].start) == 0.03
