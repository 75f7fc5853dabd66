"""The evidence of a set against integrals and normal distributions written down by hand."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.fft import dct
from scipy.signal import lfilter
from scipy.stats import multivariate_normal
from scipy.stats import t as student
from search_rigs.linear_evidence import Linear

from twin.explain.inference import evidence
from twin.explain.inference.evidence import TAIL_DEGREES, Factored, MapEstimate, best_inside
from twin.explain.inference.noise import BandNoise, rounding_variance
from twin.explain.inference.spectrum import BANDS_HZ
from twin.explain.settings import DEFAULT
from twin.physics.sensors.table import sensor_of
from twin.residuals.channels import CHANNEL_HZ, GRID_HZ, rate_over_step

Array = NDArray[np.float64]
LEVEL = DEFAULT.inference.evidence.level
ONE_BAND = {(0, 0): 1.0, (0, 1): 0.3**2}


def bands(n: int, band: int = 1) -> NDArray[np.intp]:
    return np.full(n, band, dtype=np.intp)


def one_number(n: int = 300, size: float = 0.4, seed: int = 0) -> Linear:
    """One number of mean 0.2 and deviation 0.5, white noise of deviation 1."""
    rng = np.random.default_rng(seed)
    s = rng.standard_normal(n)
    r = size * s + rng.standard_normal(n)
    return Linear(
        ["a"],
        [[(bands(n), r, s[:, None])]],
        ONE_BAND,
        mean=np.array([0.2]),
        slab=np.array([0.5]),
        odds={"a": -2.5},
    )


@pytest.fixture
def normal_priors(monkeypatch: pytest.MonkeyPatch) -> None:
    """Student priors of so many degrees of freedom are normal."""
    monkeypatch.setattr(evidence, "TAIL_DEGREES", 1e9)


# -- against integrals ------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("size", [0.0, 0.1, 0.4, 2.3])
def test_evidence_is_the_integral_over_number_and_noise_level(size: float) -> None:
    """N(r; s x, v) t(x; 0.2, 0.5) Inv-chi2(v; 2, 0.3), summed on a grid of x and log v."""
    problem = one_number(size=size)
    ((_, r, s),) = problem.channels[0]
    x, log_v = np.linspace(-2.8, 3.2, 4001), np.linspace(-1.5, 4.0, 1101)
    floor, n = ONE_BAND[0, 1], len(r)
    rss = r @ r - 2 * x * (r @ s[:, 0]) + x**2 * (s[:, 0] @ s[:, 0])

    def integral(sums: Array, weights: Array) -> float:
        v = np.exp(log_v)[:, None]
        log_p = -0.5 * (n * np.log(v) + sums / v)
        log_p += -0.5 * (LEVEL * np.log(v) + LEVEL * floor / v)  # dv = v d log v
        top = log_p.max()
        return float(top + np.log(np.sum(np.exp(log_p - top) * weights)))

    prior = student(TAIL_DEGREES).pdf((x - 0.2) / 0.5) / 0.5
    with_number = integral(rss[None, :], prior[None, :] * (x[1] - x[0]))
    without = integral(np.array([[r @ r]]), np.ones((1, 1)))
    laplace = problem.laplace
    found = laplace.best(["a"], 1.0).evidence - laplace.best([], 1.0).evidence
    assert found == pytest.approx(with_number - without - 2.5, abs=0.02)


def normal(problem: Linear, on: str, kappa: float = 1.0) -> float:
    """Log density of constants alone, whose noise is known, by their covariance."""
    priors = problem.priors
    k, f = len(problem.effects), len(problem.channels[0])
    r, noise, shared, own = [], [], [], []
    for c, flights in enumerate(problem.channels):
        for i, (_, values, slopes) in enumerate(flights):
            r.append(values[0])
            noise.append(kappa**2 * problem.floor[c, 0])
            shared.append(slopes[0])
            row = np.zeros((f, k))
            row[i] = slopes[0]
            own.append(row.ravel())
    there = np.array([e in on for e in problem.effects])
    spread = np.where(np.outer(there, there), 0.0, priors.file)
    spread[there] = spread[:, there] = 0.0
    full = priors.file.copy()
    full[np.diag_indices(k)] = np.where(there, priors.slab**2, np.diag(full))
    days = np.kron(np.eye(f), np.diag((kappa * priors.day) ** 2))
    s, d = np.array(shared), np.array(own)
    covariance = np.diag(noise) + s @ full @ s.T + d @ days @ d.T
    mean = s @ np.where(there, priors.mean, 0.0)
    density = multivariate_normal(mean, covariance).logpdf(np.array(r))
    return float(density) + 0.5 * len(r) * float(np.log(2 * np.pi))


@pytest.mark.parametrize(
    ("ages", "on", "factor"),
    [
        ((0.02, 0.05, 0.03), "", 3 * math.log(2)),  # half of a normal prior about zero
        ((0.02, 0.05, -0.03), "", -7.0),  # only a clock of its own is early: its odds
        ((1.02, 1.05, 1.03), "a", 0.0),  # beside a delay of many days nothing is early
    ],
)
def test_no_signal_is_early_unless_its_clock_is_its_own(
    ages: tuple[float, ...], on: str, factor: float
) -> None:
    flights = [(bands(1, 0), np.array([age]), np.ones((1, 2))) for age in ages]
    day = np.array([0.0, 0.02])
    usual = Linear(["a", "b"], [flights], {(0, 0): 1e-6}, day=day, odds={"b": -7.0})
    late = replace(usual, ages={1: np.array([0, 1])})
    found = (p.laplace.best([*on], 1.0).evidence for p in (late, usual))
    assert next(found) - next(found) == pytest.approx(factor, abs=0.01)


def constants(seed: int = 0, **changes: object) -> Linear:
    """Five constants in each of two flights, three numbers."""
    rng = np.random.default_rng(seed)
    channels = [
        [(bands(1, 0), rng.standard_normal(1), rng.standard_normal((1, 3))) for _ in range(2)]
        for _ in range(5)
    ]
    floor = {(c, 0): 0.3 + 0.1 * c for c in range(5)}
    made = Linear(list("abc"), channels, floor, np.array([0.3, -0.2, 0.5]), np.array([1, 0.5, 2]))
    return replace(made, **changes)  # type: ignore[arg-type]


@pytest.mark.usefixtures("normal_priors")
@pytest.mark.parametrize("on", ["", "a", "bc", "abc"])
def test_evidence_of_known_noise_is_the_normal_density(on: str) -> None:
    problem = constants()
    assert problem.laplace.best(on, 1.0).evidence == pytest.approx(normal(problem, on), abs=1e-5)


@pytest.mark.usefixtures("normal_priors")
@pytest.mark.parametrize("kappa", [0.25, 1.0])
@pytest.mark.parametrize("on", ["", "ac"])
def test_numbers_of_days_and_constants_widen_by_kappa(on: str, kappa: float) -> None:
    problem = constants(day=np.array([0.5, 0.0, 1.5]))
    found = problem.laplace.best(on, kappa).evidence
    assert found == pytest.approx(normal(problem, on, kappa), abs=1e-5)


@pytest.mark.usefixtures("normal_priors")
def test_what_a_file_is_unsure_of_counts_with_its_covariance() -> None:
    """Two numbers of the file that are off together; then one of them by an effect as well."""
    file = np.array([[1.0, 0.9, 0.0], [0.9, 1.0, 0.0], [0.0, 0.0, 0.0]])
    problem = constants(file=file)
    assert problem.laplace.best("", 1.0).evidence == pytest.approx(normal(problem, ""), abs=1e-9)
    alone = constants(file=np.diag(np.diag(file)))
    assert abs(normal(problem, "") - normal(alone, "")) > 0.1
    wider = constants(file=file, slab=np.array([1.5, 2.0, 2.0]), mean=np.zeros(3))
    assert wider.laplace.best("a", 1.0).evidence == pytest.approx(normal(wider, "a"), abs=1e-5)


# -- what it does not depend on ---------------------------------------------------------------


def test_gains_and_losses_count_alike() -> None:
    """What a number takes from one channel it adds to another of the same kind."""
    u = np.random.default_rng(2).standard_normal(200)[:, None]
    channels = [[(bands(200), 2 * u[:, 0], u)], [(bands(200), u[:, 0], -u)]]
    floor = {(c, b): 0.01 for c in (0, 1) for b in (0, 1)}
    laplace = Linear(["a"], channels, floor, mean=np.array([0.5])).laplace
    before, after = (laplace.at(["a"], 1.0, np.array([x])) for x in (0.0, 1.0))
    assert before == pytest.approx(after, abs=1e-9)


def test_differences_do_not_depend_on_units() -> None:
    """A channel in other units, its known levels with it."""
    rng = np.random.default_rng(3)
    n = 150
    rows = [rng.standard_normal((n, 3)) for _ in range(2)]

    def lead(scale: float) -> float:
        factors = (1.0, scale)
        channels = [
            [(1 + np.arange(n) % 4, f * (v[:, 0] + 0.3 * v[:, 1]), f * v[:, 1:])]
            for f, v in zip(factors, rows, strict=True)
        ]
        plain = Linear(["a", "b"], channels, {})
        noise = BandNoise.of(plain.spectrum, [0.1, 0.1 * scale])
        laplace = replace(plain, floor=noise.floor, own=noise.own).laplace
        return laplace.best(["a"], 1.0).evidence - laplace.best(["b"], 1.0).evidence

    assert lead(1e3) == pytest.approx(lead(1.0), abs=1e-6)
    assert lead(1.0) > 3


def test_one_flight_tells_no_more_than_its_samples_however_fast_it_was_logged() -> None:
    rng, samples = np.random.default_rng(5), DEFAULT.inference.evidence.samples
    leads = []
    for n in (2000, 20000):
        s = rng.standard_normal((n, 1))
        r = rng.standard_normal(n) + s[:, 0]
        plain = Linear(["a"], [[(bands(n), r, s)]], {})
        noise = BandNoise.of(plain.spectrum, [1.0])
        assert noise.own[0] * n == pytest.approx(1 / (1 / n + 1 / samples))
        laplace = replace(plain, floor=noise.floor, own=noise.own).laplace
        leads.append(laplace.best(["a"], 1.0).evidence - laplace.best([], 1.0).evidence)
    assert leads[1] == pytest.approx(leads[0], rel=0.2)
    assert leads[1] < 0.5 * samples * np.log(2)  # half the power is explained


@pytest.mark.parametrize("kept", [0.9, 0.99])
def test_the_mean_of_a_flight_is_as_unsure_as_slow_noise_makes_it(kept: float) -> None:
    """Noise of 0.2 and 2 s: nearly all means are inside what it allows, and a second time adds
    nothing."""
    rng, n, inside = np.random.default_rng(7), 1800, 0
    for _ in range(200):
        noise = lfilter([1.0], [1.0, -kept], rng.standard_normal(n + 500))[500:]
        rows = dct(noise, norm="ortho")
        band = np.searchsorted(BANDS_HZ, np.arange(n) * CHANNEL_HZ / 2 / n, side="right")
        rows[0], band[0] = rows[0] / np.sqrt(n), 0
        plain = Linear(["a"], [[(band, rows, np.zeros((n, 1)))]], {})
        before = BandNoise.of(plain.spectrum, [0.01])
        after = before.with_means_of(plain.spectrum).with_means_of(plain.spectrum)
        assert before.floor[0, 0] == pytest.approx(1e-4)
        inside += rows[0] ** 2 < 1.96**2 * after.floor[0, 0]
    assert 170 <= inside <= 196


def test_what_only_the_prior_knows_has_its_deviation() -> None:
    """And what is known is known as well as before."""
    unseen, seen = one_number(size=0.0), one_number(size=0.4)
    ((band, rows, slopes),) = unseen.channels[0]
    unseen = replace(unseen, channels=[[(band, rows, 1e-6 * slopes)]])
    assert unseen.laplace.best(["a"], 1.0).deviations()[0] == pytest.approx(0.5, rel=1e-3)
    assert seen.laplace.best(["a"], 1.0).deviations()[0] < 0.25


def test_a_number_stays_inside_its_range_and_the_others_make_the_best_of_it() -> None:
    rng = np.random.default_rng(6)
    s = rng.standard_normal((400, 2))
    s[:, 1] += 0.8 * s[:, 0]
    r = s @ [2.0, 0.1] + 0.1 * rng.standard_normal(400)
    problem = Linear(["a", "b"], [[(bands(400), r, s)]], ONE_BAND, reach=1.0)
    x = problem.laplace.best(["a", "b"], 1.0).x
    assert x[0] == pytest.approx(1.0)
    rest = r - s[:, 0]
    assert x[1] == pytest.approx(min(1.0, s[:, 1] @ rest / (s[:, 1] @ s[:, 1])), rel=0.02)


@pytest.mark.slow
@given(st.integers(0, 10_000), st.integers(1, 12))
def test_no_direction_is_better_than_the_best_inside_ranges(seed: int, m: int) -> None:
    """Karush, Kuhn and Tucker: the slope is zero inside, and points outward at an end."""
    rng = np.random.default_rng(seed)
    root = rng.standard_normal((m + 2, m)) * np.logspace(-2, 2, m)
    h, pull = root.T @ root, root.T @ rng.standard_normal(m + 2) * 3.0
    size = np.abs(np.linalg.solve(h, pull)) + 1e-3
    low = np.where(rng.random(m) < 0.3, -np.inf, -rng.random(m) * size)
    high = np.where(rng.random(m) < 0.3, np.inf, rng.random(m) * size)
    x = best_inside(Factored.of(h), pull, low, high)
    assert np.all((x >= low) & (x <= high))
    down = pull - h @ x
    scale = 1e-7 * (np.abs(h) @ np.abs(x) + np.abs(pull))
    assert np.all((down <= scale) | np.isclose(x, high, rtol=1e-9, atol=0))
    assert np.all((down >= -scale) | np.isclose(x, low, rtol=1e-9, atol=0))


@pytest.mark.slow
@given(st.integers(0, 10_000), st.integers(1, 8), st.integers(0, 3))
def test_a_curvature_is_factored_whatever_its_units_and_its_rank(
    seed: int, m: int, lost: int
) -> None:
    """Exact inverse and determinant where it is of full rank; none of a rank too low raises."""
    rng = np.random.default_rng(seed)
    units = np.exp(rng.uniform(-15, 15, m))
    root = rng.standard_normal((m + 2 - lost, m)) * units
    h = root.T @ root + np.diag((1e-9 * units) ** 2)
    made = Factored.of(h)
    assert np.all(np.isfinite(made.inverse()))
    assert np.isfinite(made.log_determinant)
    scaled = h / np.outer(units, units)
    if np.linalg.cond(scaled) < 1e5:
        expected = np.linalg.slogdet(scaled)[1] + 2 * float(np.log(units).sum())
        assert made.log_determinant == pytest.approx(expected, abs=1e-5)
        assert made.inverse() * np.outer(units, units) == pytest.approx(
            np.linalg.inv(scaled), rel=1e-5, abs=1e-5 * float(np.abs(np.linalg.inv(scaled)).max())
        )


def test_rounding_leaves_the_variance_that_is_said() -> None:
    """Readings rounded to the least count, against the spectrum of what that leaves of them."""
    rng = np.random.default_rng(8)
    for name in ("acc_x", "gyro_rate_y"):
        sensor = sensor_of(name)
        assert sensor is not None
        step, n = sensor.least_count, 1 << 16
        smooth = np.cumsum(rng.standard_normal(n)) * step
        left = smooth - step * np.round(smooth / step)
        if sensor.rate:
            left = rate_over_step(left)
        freq = np.arange(n) * GRID_HZ / 2 / n
        power = dct(left, norm="ortho") ** 2 * CHANNEL_HZ / GRID_HZ
        for b in range(3 if sensor.rate else 1, len(BANDS_HZ)):  # below, ends of the record
            inside = (freq >= BANDS_HZ[b - 1]) & (freq < BANDS_HZ[b])
            assert float(power[inside].mean()) == pytest.approx(
                float(rounding_variance(name)[b]), rel=0.2
            )


def test_a_number_is_told_better_with_what_it_trades_against_held() -> None:
    """Of two normal numbers the one has the variance 1 / h with the other held."""
    h = np.array([[4.0, 3.0], [3.0, 9.0]])
    best = MapEstimate(0.0, 1.0, np.zeros(3), np.array([0, 2]), Factored.of(h))
    assert best.ridge(0, [2]) == pytest.approx(best.deviations()[0] / 0.5)
    assert best.ridge(2, [0, 1]) == pytest.approx(best.deviations()[2] * 3.0)
    assert (best.ridge(0, []), best.ridge(0, [1]), best.ridge(1, [0])) == (1.0, 1.0, 1.0)
