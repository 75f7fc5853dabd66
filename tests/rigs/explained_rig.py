"""A folder as `explain` leaves it, written by hand."""

import json
from pathlib import Path

from twin.vehicle_file import vehicle_text

COPTER = "copter_default"
CHANNEL = {"before": 0.5, "after": 0.02, "shrink": 0.96, "shrink_ci95": [0.9, 0.97]}


def explained(
    folder: Path, spans: object = None, channel: object = CHANNEL, stable: bool = True
) -> Path:
    """A folder of a vehicle with drag, taught by flight a, whose flight b was held out."""
    folder.mkdir()
    text = vehicle_text(COPTER)[0].replace("made up: ", "measured: ")
    effect = '\n[effects.rotor_drag]\nk_xy_1_s = {value = 0.5, unit = "1/s", sd = 0.01, '
    (folder / "vehicle.toml").write_text(f'{text}{effect}source = "uavtwin explain, a"}}\n')
    found = {
        "verdict": "named",
        "effects": [{"name": "rotor_drag", "probability": 0.97}],
        "settings": {"hash": "0123456789ab", "changed": {"prior": 2}},
        "holdout": [{"flight": "b", "spans_s": spans}],
        "gap": {"acc_x": channel},
        "closed_loop": {"stable": stable, "missions": {"hover": {}, "tour": {}}},
    }
    (folder / "explain.json").write_text(json.dumps(found))
    inputs = [{"name": "a.ulg", "sha256": "0" * 64}]
    (folder / "run.json").write_text(json.dumps({"inputs": inputs}))
    return folder
