"""Sets that matter, weighed: on made-up linear problems, where a refit changes nothing."""

from collections.abc import Mapping, Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from search_rigs.linear_evidence import Linear

from twin.explain.inference.fit import State
from twin.explain.inference.posterior import Posterior, SearchResult, Tried, log_posterior, weigh

Array = NDArray[np.float64]
NAMES = ("accel_bias", "gyro_bias", "mass_offset", "thrust_scale")


def weighed(
    slopes: Array,
    residual: Array,
    on: Sequence[str],
    seed: int = 0,
    bent: bool = False,
    behind: Mapping[tuple[str, ...], float] | None = None,
) -> Posterior:
    """One channel, one number per effect.

    Args:
        slopes: By the numbers, shape (n, k).
        residual: Shape (n,).
        on: Where a search ended.
        seed: Of the chain.
        bent: Whether nothing is found to be as good as the end once it is fitted.
        behind: Sets that were fitted, and by how many nats each ended behind the end.
    """
    effects = NAMES[: slopes.shape[1]]
    band = np.ones(len(residual), dtype=np.intp)
    floor = {(0, 0): 1.0, (0, 1): 1e-4}
    odds = dict.fromkeys(effects, -2.5)
    linear = Linear(effects, [[(band, residual, slopes)]], floor, odds=odds)
    laplace = linear.laplace

    end = State(tuple(sorted(on)), laplace.best(on, 1.0), linear.spectrum)
    problem: Any = SimpleNamespace(priors=linear.priors)
    tried: Tried = {((), 1.0): log_posterior(end)} if bent else {}
    tried |= {(k, 1.0): log_posterior(end) - less for k, less in (behind or {}).items()}
    return weigh(problem, SearchResult(end, laplace, tried), seed)


def noise(n: int = 400, seed: int = 0) -> tuple[np.random.Generator, Array]:
    rng = np.random.default_rng(seed)
    return rng, rng.standard_normal(n)


def test_one_of_two_that_are_the_same_is_there_each_with_half_the_probability() -> None:
    rng, e = noise()
    s = rng.standard_normal(400)
    both = np.column_stack([s, s, rng.standard_normal(400)])
    found = weighed(both, 0.5 * s + e, ["accel_bias"])
    assert found.inclusion["accel_bias"] == pytest.approx(found.inclusion["gyro_bias"], rel=1e-6)
    assert 0.5 <= found.inclusion["accel_bias"] < 0.6
    assert found.inclusion["mass_offset"] < 0.05
    assert found.exchangeable("accel_bias") == ("gyro_bias",)
    assert found.exchangeable("gyro_bias") == ("accel_bias",)
    assert found.exchangeable("mass_offset") == ()


def test_an_exchange_that_was_fitted_counts_as_fitted_in_every_set_that_makes_it() -> None:
    rng, e = noise()
    s = rng.standard_normal(400)
    other = rng.standard_normal(400)
    both = np.column_stack([s, s, other])
    found = weighed(both, 0.5 * s + e, ["accel_bias"], behind={("gyro_bias",): 25.0})
    assert found.inclusion["accel_bias"] > 0.999
    assert found.inclusion["gyro_bias"] < 0.1  # beside the other; in its place never
    assert sum(w.probability for w in found.sets if "accel_bias" not in w.effects) < 1e-9


def test_what_explains_much_is_sure_and_what_explains_nothing_is_not_there() -> None:
    rng, e = noise(seed=1)
    s = rng.standard_normal((400, 3))
    found = weighed(s, s @ [0.7, 0.0, -0.6] + e, ["accel_bias", "mass_offset"])
    assert found.inclusion["accel_bias"] > 0.999 < found.inclusion["mass_offset"]
    assert found.inclusion["gyro_bias"] < 0.05
    assert found.sets[0].effects == ("accel_bias", "mass_offset")
    assert found.without["accel_bias"] > 20
    best = found.sets[0].best
    assert best.x[:3] == pytest.approx([0.7, 0.0, -0.6], abs=0.15)
    assert best.deviations()[0] == pytest.approx(1 / np.sqrt(400), rel=0.15)


def test_probabilities_add_up_and_are_those_of_all_sets() -> None:
    """Four numbers have sixteen sets: each counts by its evidence."""
    rng, e = noise(60, 2)
    s = rng.standard_normal((60, 4))
    found = weighed(s, s @ [0.3, 0.2, 0.1, 0.0] + e, ["accel_bias"])
    chances = np.array([w.probability for w in found.sets])
    assert chances.sum() == pytest.approx(1.0)
    assert list(chances) == sorted(chances, reverse=True)
    evidences = np.array([w.best.evidence for w in found.sets])
    expected = np.exp(evidences - evidences.max())
    assert chances == pytest.approx(expected / expected.sum(), rel=1e-6)
    for e_, p in found.inclusion.items():
        assert p == pytest.approx(sum(w.probability for w in found.sets if e_ in w.effects))


def test_draws_decide_nothing_but_which_sets_are_met() -> None:
    rng, e = noise(200, 3)
    s = rng.standard_normal((200, 4))
    residual = s @ [0.2, 0.15, 0.1, 0.0] + e
    first, again, other = (weighed(s, residual, ["accel_bias"], seed) for seed in (0, 0, 1))
    assert first.inclusion == again.inclusion
    assert [w.effects for w in first.sets] == [w.effects for w in again.sets]
    for effect, p in first.inclusion.items():
        assert other.inclusion[effect] == pytest.approx(p, abs=0.02)
        assert type(effect) is str
    assert all(type(e_) is str for w in first.sets for e_ in w.effects)


def test_a_fit_that_does_better_without_an_effect_takes_its_lead_away() -> None:
    """The linearisation gives an effect twenty nats; fitted without it, the set loses none."""
    rng, e = noise(300, 4)
    s = rng.standard_normal((300, 2))
    residual = s @ [0.4, 0.0] + e
    straight = weighed(s, residual, ["accel_bias"])
    assert straight.without["accel_bias"] > 15
    bent = weighed(s, residual, ["accel_bias"], bent=True)
    assert bent.without["accel_bias"] == pytest.approx(0.0)
    assert bent.inclusion["accel_bias"] == pytest.approx(0.5, abs=0.05)


def test_what_is_wrong_about_nothing_is_not_held_against_what_does_as_well() -> None:
    """The linearisation is wrong by all that an effect earns, over nothing: one that does the same
    in its place keeps up with it."""
    rng, e = noise(300, 5)
    s = rng.standard_normal(300)
    found = weighed(np.column_stack([s, s]), 0.4 * s + e, ["accel_bias"], bent=True)
    assert found.inclusion["accel_bias"] == pytest.approx(found.inclusion["gyro_bias"], rel=1e-6)
