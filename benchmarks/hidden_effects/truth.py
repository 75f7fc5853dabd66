"""What the truth file of a case holds."""

from dataclasses import asdict
from typing import Any

import numpy as np

from .cases import Case
from .hiding.effect import Number, Truth
from .life.days import mean_deviations
from .life.file_errors import seen_from
from .life.shown import shown
from .planning import Plan, aircraft_of, hidden, missions_of, sizes
from .plants.kinds import EFFECTS
from .plants.noise import NOISE
from .plants.own.flight import Trace
from .plants.own.parameters import STEP_S
from .plants.own.physics import Dynamics

MATERIAL = 0.5
"""An effect that shows by less than this, in noise of a reading, need not be found."""


def truth_json(case: Case, truth: dict[str, Truth]) -> dict[str, Any]:
    """The part of the truth file that every plant writes."""
    return {
        "case": case.id,
        "plant": case.plant,
        "kind": case.kind,
        "magnitude": case.magnitude,
        "noise": case.noise,
        "seed": case.seed,
        "missions": missions_of(case),
        "effects": [
            {
                "name": name,
                "outside": EFFECTS[name].outside,
                "parameters": {k: _number(v) for k, v in numbers.items()},
            }
            for name, numbers in truth.items()
        ],
    }


def life_json(
    case: Case, planned: Plan, trace: Trace, last: int, dynamics: Dynamics
) -> dict[str, Any]:
    """What the truth file of a case of `life` has on top; `last` is its last flight."""
    ratios = {}
    for name in case.effects if case.kind != "since" else ():
        alone = hidden(case, aircraft_of(case).nominal, name)[0]
        ratios[name] = shown(
            aircraft_of(case), alone, trace, last, NOISE[case.noise], case.life, dynamics
        )
    fitted = [day for name, day in planned.days.items() if name.startswith("fit")]
    content: dict[str, Any] = {
        "life": case.life.as_json,
        "class": (*case.effects, "none")[0] if case.kind == "since" else None,
        "sizes": sizes(case) if case.kind != "since" else {},
        "shown": ratios,
        "material": [name for name, ratio in ratios.items() if ratio >= MATERIAL],
        "days": {name: day.as_json for name, day in planned.days.items()},
        "day_means": mean_deviations(fitted, aircraft_of(case)) if fitted else {},
        "file": [
            {**asdict(error), "z": error.z}
            for error in (planned.file.errors if planned.file else ())
        ],
    }
    believed = planned.file.believed if planned.file else aircraft_of(case)
    seen = seen_from(believed.nominal, planned.plant)
    if fitted:
        late = [day.delay_steps * STEP_S for day in fitted]
        steps = planned.plant.position_delay * STEP_S
        seen["position_delay"] = {"delay_s": Number(steps + float(np.mean(late)), "s")}
    content["seen_from_file"] = {
        name: {k: _number(v) for k, v in numbers.items()} for name, numbers in seen.items()
    }
    return content


def _number(number: Number) -> dict[str, Any]:
    return {
        "value": number.value,
        "unit": number.unit,
        "neutral": number.neutral,
        "exact": number.exact,
    }
