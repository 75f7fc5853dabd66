"""The FMUs that the tests look at."""

from collections.abc import Callable, Iterable
from dataclasses import replace
from functools import cache

import numpy as np
import pandas as pd

from fmus import FmuModel, component_model, fuse, replay_model
from twin.component import Component, ComponentBuilder
from twin.logs import Flight
from twin.physics.airframe import airframe
from twin.physics.battery import battery
from twin.physics.sensors.imu import imu
from twin.vehicle_file import load_vehicle

COMPONENTS: dict[str, Callable[[], Component]] = {
    "airframe-feisi_x150": lambda: airframe(load_vehicle("feisi_x150")),
    "airframe-copter_default": lambda: airframe(load_vehicle("copter_default")),
    "airframe-crazyflie": lambda: airframe(load_vehicle("crazyflie")),
    "airframe-rotor_speed": lambda: airframe(load_vehicle("copter_default"), "rotor_speed"),
    "imu": lambda: imu(load_vehicle("copter_default")),
    "imu-filtered": lambda: imu(
        replace(load_vehicle("copter_default"), accel_cutoff_hz=80.0, gyro_cutoff_hz=60.0)
    ),
    "battery": lambda: battery(load_vehicle("crazyflie")),
}
KINDS = (*COMPONENTS, "replay", "fused")
ALL = [(kind, fmi) for kind in KINDS for fmi in (2, 3)]


@cache
def component(kind: str) -> Component:
    return COMPONENTS[kind]()


@cache
def model(kind: str) -> FmuModel:
    others = {"replay": replay_example, "fused": fused_example}
    return others[kind]() if kind in others else component_model(component(kind))


def recorded(**columns: Iterable[float]) -> Flight:
    """A flight of these columns, `time` among them."""
    return Flight("example", pd.DataFrame({k: np.asarray(v) for k, v in columns.items()}))


def replay_example() -> FmuModel:
    """100 Hz commands, held, and a barometer at a quarter of the rate, interpolated."""
    t = np.arange(200) / 100
    baro = np.where(np.arange(200) % 4 == 0, 101325 - t, np.nan)
    flight = recorded(time=t, cmd_1=0.5 + 0.1 * np.sin(t), baro_pa=baro)
    return replay_model(flight, ("cmd_1", "baro_pa"), linear=("baro_pa",))


def receiver() -> Component:
    """Position fixes that are late, noisy, and come at odd instants."""
    m = ComponentBuilder("receiver", "Position receiver")
    m.sampled(0.0107, "Time between two fixes")
    delay = m.parameter("delay", 0.05, "s", "Age of a fix when it comes", minimum=0)
    noise = m.parameter("noise", 0.0, "m", "Noise of a fix, standard deviation", minimum=0)
    for a in ("x", "y", "z"):
        position = m.input(f"pos_{a}", "m", f"Position, {a}")
        fix = m.memory(f"fix_{a}", "m", f"Last fix, {a}")
        late = m.delayed(f"fix_{a}", position, delay, 10)
        m.update(f"fix_{a}", late + noise * m.noise())
        m.output(f"fix_{a}", "m", f"Last fix, {a}", fix)
    return m.build()


def commands() -> FmuModel:
    """Recorded commands, a straight line between 25 samples a second."""
    t = np.arange(100) / 25
    columns = {f"cmd_{i}": 0.55 + 0.1 * np.sin(5 * t + i) for i in range(1, 5)}
    return replay_model(recorded(time=t, **columns), tuple(columns), linear=tuple(columns))


@cache
def fused_parts() -> dict[str, FmuModel]:
    """Models by name, not in the order of their dependencies."""
    return {
        "imu": model("imu-filtered"),
        "battery": model("battery"),
        "airframe": model("airframe-crazyflie"),
        "receiver": component_model(receiver()),
        "flight": commands(),
    }


def fused_connections() -> list[tuple[str, str]]:
    """From each output to every input of its name, airframe to sensors and back by the battery."""
    parts = fused_parts()
    return [
        (f"{a}.{v.name}", f"{b}.{v.name}")
        for a in ("airframe", "battery", "flight")
        for b in parts
        for v in parts[a].variables
        if v.causality == "output"
        and v.name in {u.name for u in parts[b].variables if u.causality == "input"}
    ]


def fused_example() -> FmuModel:
    """Airframe, battery, sensors and recorded commands in one."""
    return fuse("fused", "Several parts in one", fused_parts(), fused_connections())
