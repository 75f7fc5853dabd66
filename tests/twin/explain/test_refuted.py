"""Effects that flights of the fit ask for and held-out ones refute."""

from collections.abc import Sequence
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from search_rigs.courses import TRIANGLE

from twin.explain import explanation
from twin.explain.explanation import Explanation, explain
from twin.explain.holdout import Attribution, Comparison, farther_by
from twin.explain.inference.selection import Naming, Resemblance, Verdict
from twin.explain.settings import DEFAULT
from twin.explain.stochastic.spectral import StochasticEffect
from twin.logs import Flight
from twin.residuals.channels import CHANNEL_HZ, ChannelData
from twin.vehicle import Vehicle
from twin.vehicle_file import load_vehicle
from uavtwin.demo.flights import fly

COPTER = load_vehicle("copter_default")
DRAG_1_S, CANT_M = 0.5, 0.004


def residual(name: str, rms: float) -> ChannelData:
    """Noise of twenty seconds."""
    values = np.random.default_rng(0).normal(0, rms, 20 * round(CHANNEL_HZ))
    t_s = np.arange(len(values)) / CHANNEL_HZ
    return ChannelData(name, "1", t_s, values, values, values[:, None][:, :0], 0 * t_s.astype(int))


@pytest.mark.parametrize(
    ("after", "where"),
    [
        ((1.0, 2.0, 1.0), ["gyro_rate_z"]),
        ((0.4, 2.0, 1.0), []),  # pays for itself in another force
        ((0.9, 2.0, 1.0), ["gyro_rate_z"]),
        ((1.0, 1.0, 1.0), []),
        ((1.0, 1.0, 3.0), []),  # no force and no moment
        ((1.5, 2.0, 1.0), ["acc_x", "gyro_rate_z"]),
    ],
)
def test_an_effect_has_to_pay_in_some_force_for_what_it_costs(
    after: tuple[float, float, float], where: list[str]
) -> None:
    names = ("acc_x", "gyro_rate_z", "mag_x")
    effect = Attribution("made_up", (), (), [[residual(n, 1.0) for n in names]])
    told = [[residual(n, rms) for n, rms in zip(names, after, strict=True)]]
    assert farther_by(effect, told, 0, DEFAULT.holdout) == where


VIBRATION = StochasticEffect("vibration", 5.0, {"vibration.accel_m_s2": 2.0}, {}, ("acc_x",), 0.5)


@pytest.mark.parametrize(
    ("shaken", "verdict"), [((VIBRATION,), "named"), ((), "cannot_tell")], ids=["shaken", "calm"]
)
def test_what_has_no_mean_is_not_refuted_by_means(
    monkeypatch: pytest.MonkeyPatch, shaken: tuple[StochasticEffect, ...], verdict: str
) -> None:
    """All effects with a mean are; something only acts like them then."""
    taken: list[str] = []

    def take_back(found: Explanation, alike: Sequence[Resemblance], *_: object) -> Explanation:
        taken.extend(r.effect for r in alike)
        return found

    monkeypatch.setattr(explanation, "_taken_back", take_back)
    monkeypatch.setattr(explanation, "farther_by", lambda a, *_: ["acc_x"] * (a.effect == "lag"))
    naming = SimpleNamespace(named=("lag",), undecided=("scale",), standing={})
    found = Explanation(
        "named",
        COPTER,
        ("one",),
        naming=cast(Naming, naming),
        stochastic=shaken,
        comparison=cast(Comparison, SimpleNamespace(after=(), worse=True, warnings=())),
        attributions=tuple(Attribution(e, (), (), []) for e in ("lag", "scale")),
    )
    assert explanation._without_refuted(found, 0, lambda same: same).verdict == verdict
    assert taken == ["lag", "scale"] * bool(shaken)


@pytest.mark.parametrize("searched", ["nothing", "unnamed", "cannot_tell"])
def test_what_has_no_mean_is_named_whatever_else_is_unclear(searched: Verdict) -> None:
    naming = cast(Naming, SimpleNamespace(verdict=searched))
    assert explanation._verdict(naming, None, (VIBRATION,)) == "named"
    assert explanation._verdict(naming, None, ()) == searched


def flown(name: str, seed: int, cant_m: float) -> Flight:
    """With drag, and rotors that are canted."""
    drag = {"k_xy_1_s": DRAG_1_S, "k_z_1_s": 0.0, "height_m": 0.0, "spin_share": 0.0}
    plant: Vehicle = COPTER.with_effects({"rotor_drag": drag, "rotor_cant": {"yaw_m": cant_m}})
    return fly(COPTER, plant, seed, name, TRIANGLE)


def explained(held_out_m: float) -> Explanation:
    """Two flights with the cant, and one with another."""
    fit = [flown("one", 1, CANT_M), flown("two", 2, CANT_M)]
    held = [flown("three", 3, held_out_m)]
    return explain(fit, held, COPTER, missions=("hover",), indoors=True, suggest=False)


@pytest.mark.slow
def test_what_held_out_flights_refute_is_not_named() -> None:
    """Canted in the flights of the fit, the other way in the one held out; the drag is in all."""
    found = explained(-CANT_M)
    assert found.naming is not None
    assert found.comparison is not None
    assert found.added is not None
    assert found.naming.named == ("rotor_drag",)
    (alike,) = found.naming.resemblances
    assert alike.effect == "rotor_cant"
    assert "gyro_rate_z" in alike.why
    assert [*found.added.effects] == ["rotor_drag"]
    assert not any(g.worse for g in found.comparison.gaps)
    assert any(w.startswith("something acts like rotor_cant") for w in found.warnings)


@pytest.mark.slow
def test_what_held_out_flights_bear_out_is_named() -> None:
    found = explained(CANT_M)
    assert found.naming is not None
    assert {*found.naming.named} == {"rotor_drag", "rotor_cant"}
    assert not found.naming.resemblances
