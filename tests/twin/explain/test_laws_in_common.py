"""Laws that several effects share: one name and one figure, whichever of them was planted, or both
at once."""

import re
from collections.abc import Mapping

import pytest
from search_rigs.courses import TRIANGLE

from twin.effects import EFFECTS, FAMILIES
from twin.effects.air import LINEAR_DRAG
from twin.explain.explanation import explain
from twin.logs import Flight
from twin.vehicle import GRAVITY_M_S2
from twin.vehicle_file import load_vehicle
from uavtwin.demo.flights import fly
from uavtwin.explain_record import explain_record
from uavtwin.headline import called

COPTER = load_vehicle("copter_default")
DRAG_1_S = 0.3
PLANTED = {
    "rotor_drag": {"k_xy_1_s": DRAG_1_S, "k_z_1_s": 0.0, "height_m": 0.02, "spin_share": 0.5},
    "blade_flapping": {"k_rad_s_m": DRAG_1_S / GRAVITY_M_S2, "height_m": 0.03},
}


def test_numbers_of_a_family_are_those_of_its_effects() -> None:
    for family in FAMILIES:
        assert family.weights[f"{family.first}.k_xy_1_s"] == 1.0
        for full in family.weights:
            effect, _, name = full.partition(".")
            assert name in {p.name for p in EFFECTS[effect].parameters}
    assert called("blade_flapping") == "rotor drag by blade flapping"
    assert called("rotor_drag") == LINEAR_DRAG.name == "rotor drag"


def flown(effects: Mapping[str, Mapping[str, float]], seed: int) -> Flight:
    plant = COPTER.with_effects(effects)
    return fly(COPTER, plant, seed, f"flight {seed}", TRIANGLE)


@pytest.mark.slow
@pytest.mark.parametrize("effect", PLANTED)
def test_drag_has_one_name_and_one_figure_by_either_law(effect: str) -> None:
    plant = {effect: PLANTED[effect]}
    fit, held = [flown(plant, 1), flown(plant, 2)], [flown(plant, 3)]
    found = explain(fit, held, COPTER, missions=("hover",), indoors=True, suggest=False)
    said = explain_record(found)
    assert said.verdict == "named"
    (total,) = said.totals
    assert total.name == "rotor drag"
    assert total.value == pytest.approx(DRAG_1_S, rel=0.05)
    assert total.ci95[0] < DRAG_1_S < total.ci95[1]
    assert said.headline.text.startswith("Missing from the model: rotor drag")
    assert said.effects[0].name in total.effects


@pytest.mark.slow
@pytest.mark.parametrize(("k_xy_1_s", "height_m"), [(0.25, 0.02), (0.2, 0.0)])
def test_both_laws_at_once_are_told_in_sum(k_xy_1_s: float, height_m: float) -> None:
    """Be one of them sure by itself or not, the sentence has the figure of both."""
    flapping = {"k_rad_s_m": 0.02, "height_m": height_m}
    plant = {"rotor_drag": {"k_xy_1_s": k_xy_1_s, "height_m": height_m}, "blade_flapping": flapping}
    planted = k_xy_1_s + flapping["k_rad_s_m"] * GRAVITY_M_S2
    fit, held = [flown(plant, 1), flown(plant, 2)], [flown(plant, 3)]
    said = explain_record(
        explain(fit, held, COPTER, missions=("hover",), indoors=True, suggest=False)
    )
    (total,) = said.totals
    assert total.value == pytest.approx(planted, rel=0.03)
    (first,) = said.effects
    assert first.name in total.effects
    assert first.probability == total.probability
    text = said.headline.text
    figure = re.match(r"Missing from the model: rotor drag (by blade flapping )?([\d.]+) ", text)
    assert figure is not None, text
    assert float(figure[2]) == pytest.approx(planted, rel=0.03)
    assert "Also possible" not in text
    if len(total.effects) > 1:
        assert "How much of the rotor drag is blade flapping, these flights do not tell." in text
