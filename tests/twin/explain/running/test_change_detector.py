"""Sums over frames against the same model written out as one large Gaussian."""

import numpy as np
import pytest
from numpy.typing import NDArray

from twin.explain.running.detector import RECENT, ChangeDetector, ChangeEvidence
from twin.explain.running.hypotheses import Hypothesis

Array = NDArray[np.float64]
K, FORGET = 5, 0.97
STANDING = np.array([0.3, 2.0, 1.0, 0.5, 4.0])
HYPOTHESES = (
    Hypothesis("mass_offset", "", (0,), np.array([0.4]), np.array([0.5]), -1.0, False),
    Hypothesis("cog_offset", "", (1, 3), np.zeros(2), np.array([1.0, 0.2]), -1.0, False),
    Hypothesis("rotor_efficiency_loss", "1", (4,), np.ones(1), np.ones(1), -1.0, True),
)
EVERY = np.arange(K)


def frames(n: int, seed: int, begins: int = 10**9, jump: float = 0.0) -> list[Array]:
    """Residual and slopes of each frame, shape (6, 1 + K)."""
    rng = np.random.default_rng(seed)
    eta = STANDING * rng.standard_normal(K)
    made = []
    for k in range(n):
        slopes = rng.standard_normal((6, K))
        theta = np.zeros(K)
        theta[0] = jump * (k >= begins)
        residual = slopes @ (eta + theta) + rng.standard_normal(6)
        made.append(np.column_stack([residual, slopes]))
    return made


def counted(made: list[Array]) -> ChangeDetector:
    detector = ChangeDetector(HYPOTHESES, STANDING, FORGET, oldest=1000, least=2)
    for k, rows in enumerate(made):
        detector.add(k, [(EVERY, rows.T @ rows)])
    return detector


def batch(made: list[Array], h: Hypothesis, start: int) -> tuple[float, Array]:
    """Log Bayes factor and numbers, from covariances of all samples at once."""
    last = len(made) - 1
    rows = np.vstack([np.sqrt(FORGET ** (last - k)) * r for k, r in enumerate(made)])
    frame = np.repeat(np.arange(len(made)), 6)
    r, n = rows[:, 0], rows[:, 1:]
    s = n[:, list(h.columns)] * (frame >= start)[:, None]
    nothing = np.eye(len(r)) + n @ np.diag(STANDING**2) @ n.T
    something = nothing + s @ np.diag(h.sd**2) @ s.T

    def density(covariance: Array, off: Array) -> float:
        _, logdet = np.linalg.slogdet(covariance)
        return float(-0.5 * (logdet + off @ np.linalg.solve(covariance, off)))

    off = r - s @ h.mean
    numbers = h.mean + np.diag(h.sd**2) @ s.T @ np.linalg.solve(something, off)
    return density(something, off) - density(nothing, r), numbers


def of(detector: ChangeDetector, k: int) -> ChangeEvidence:
    return detector.changes()[k]


@pytest.mark.parametrize("k", range(2))
def test_recursion_is_the_batch(k: int) -> None:
    made = frames(14, seed=3, begins=6, jump=1.5)
    jump = of(counted(made), k)
    assert [*jump.starts] == list(range(13))  # the last frame is too young
    for t, start in enumerate(jump.starts):
        evidence, numbers = batch(made, HYPOTHESES[k], int(start))
        assert jump.evidence[t] == pytest.approx(evidence, abs=1e-8)
        np.testing.assert_allclose(jump.numbers[t], numbers, atol=1e-8)


def test_what_only_adds_never_takes_away() -> None:
    made = frames(12, seed=1)
    for k, rows in enumerate(made):
        rows[:, 0] -= 5.0 * rows[:, 5] * (k >= 5)
    jump = of(counted(made), 2)
    assert np.all(np.isneginf(jump.evidence[jump.numbers[:, 0] <= 0]))
    assert np.any(jump.numbers[:, 0] <= 0)


def test_a_jump_is_found_where_it_is() -> None:
    jump = of(counted(frames(40, seed=5, begins=30, jump=2.0)), 0)
    best = int(np.argmax(jump.evidence))
    assert abs(jump.starts[best] - 30) <= 1
    assert jump.evidence[best] > 20
    sd = float(np.sqrt(jump.covariance[best, 0, 0]))
    assert abs(jump.numbers[best, 0] - 2.0) < 4 * sd


def test_settled_is_the_posterior_with_the_jump_inside() -> None:
    """Standing numbers after a settled jump: those of the larger model, from then on."""
    made = frames(20, seed=8, begins=12, jump=1.0)
    detector = counted(made)
    detector.settle(of(detector, 0), 12)
    mean, covariance = detector.standing()

    last = len(made) - 1
    rows = np.vstack([np.sqrt(FORGET ** (last - k)) * r for k, r in enumerate(made)])
    gated = rows[:, 1] * (np.repeat(np.arange(20), 6) >= 12)
    design = np.column_stack([rows[:, 1:], gated])
    prior = np.diag(np.concatenate([STANDING**-2, HYPOTHESES[0].sd ** -2]))
    expected = np.linalg.inv(design.T @ design + prior)
    held = prior @ np.concatenate([np.zeros(K), HYPOTHESES[0].mean])
    best = expected @ (design.T @ rows[:, 0] + held)
    both = np.hstack([np.eye(K), np.eye(K)[:, :1]])
    np.testing.assert_allclose(mean, both @ best, atol=1e-8)
    np.testing.assert_allclose(covariance, both @ expected @ both.T, atol=1e-8)
    assert detector.changes() == []


def test_nothing_grows_with_the_flight() -> None:
    detector = ChangeDetector(HYPOTHESES, STANDING, FORGET, oldest=120, least=2)
    candidate_starts = []
    for k in range(2000):
        detector.add(k, [(EVERY, np.ones((1 + K, 1 + K)))])
        candidate_starts.append(detector.candidate_starts)
    assert max(candidate_starts) == max(candidate_starts[:300]) <= 4 * RECENT
    jump = of(detector, 0)
    assert jump.starts.min() >= 2000 - 121
    assert np.all(np.isfinite(jump.evidence))
