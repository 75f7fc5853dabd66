"""Parts of systems against what is known of them in closed form."""

import numpy as np
import pytest
import torch

from benchmarks.paper.blocks import (
    CausalConvolution,
    Critic,
    Diffusion,
    chain_of,
    clip_weights,
    drawn_chain,
    gradient_penalty,
    hinge,
    real_or_fake,
)


@pytest.mark.parametrize(("steps", "schedule"), [(50, "cosine"), (100, "linear")])
def test_a_diffusion_that_knows_its_distribution_draws_from_it(steps: int, schedule: str) -> None:
    """Of a Gaussian the best v is known: E[v | x] = (a b (1 - s^2) x - b m) / (a^2 s^2 + b^2)."""
    mean, spread = 1.5, 0.4
    diffusion = Diffusion(steps, schedule)  # type: ignore[arg-type]

    def best(x: torch.Tensor, step: torch.Tensor) -> torch.Tensor:
        a, b = diffusion.signal(step)
        clean = mean + a * spread**2 * (x - a * mean) / (a**2 * spread**2 + b**2)
        noise = (x - a * clean) / b
        return a * noise - b * clean

    torch.manual_seed(0)
    drawn = diffusion.sample(best, (200, 50, 1))
    assert float(drawn.mean()) == pytest.approx(mean, abs=0.02)
    assert float(drawn.std()) == pytest.approx(spread, rel=0.1)  # some of it is lost to steps


@pytest.mark.parametrize(("steps", "schedule"), [(50, "cosine"), (100, "linear")])
def test_little_of_the_signal_is_left_at_the_end(steps: int, schedule: str) -> None:
    share = Diffusion(steps, schedule).signal_share  # type: ignore[arg-type]
    assert bool((share[1:] < share[:-1]).all()) and share[0] > 0.99 and share[-1] < 1e-3


def test_the_loss_is_that_of_the_best_guess() -> None:
    """Of unit noise the best v is nought, and what it leaves is the square of v: one."""
    diffusion, scored = Diffusion(50, "cosine"), torch.ones(400, 20, 2)
    torch.manual_seed(0)
    loss = diffusion.loss(lambda x, _: torch.zeros_like(x), torch.randn(400, 20, 2), scored)
    assert float(loss) == pytest.approx(1.0, rel=0.03)


def test_the_penalty_of_a_line_is_known() -> None:
    """A critic of slope (3, 4) has a gradient of 5 everywhere."""
    slope = torch.tensor([3.0, 4.0])
    real, fake = torch.randn(8, 2), torch.randn(8, 2)
    assert float(gradient_penalty(lambda x: x @ slope, real, fake)) == pytest.approx(16.0)


def test_losses_of_critics() -> None:
    far, near = torch.tensor([2.0, 3.0]), torch.tensor([-2.0, -1.5])
    assert float(hinge(far, near)) == 0.0
    assert float(hinge(torch.zeros(2), torch.zeros(2))) == 1.0
    assert float(real_or_fake(torch.zeros(3), True)) == pytest.approx(np.log(2))
    network = torch.nn.Linear(4, 4)
    clip_weights(network, 0.01)
    assert all(float(p.detach().abs().max()) <= 0.01 for p in network.parameters())


def test_a_causal_convolution_sees_nothing_later() -> None:
    torch.manual_seed(0)
    layer, x = CausalConvolution(2, 3, 3, dilation=4), torch.randn(1, 2, 30)
    later = x.clone()
    later[..., 20:] += 1
    before, after = layer(x), layer(later)
    assert before.shape == (1, 3, 30)
    torch.testing.assert_close(before[..., :20], after[..., :20])
    assert not torch.equal(before[..., 20:], after[..., 20:])


def test_a_critic_scores_stretches() -> None:
    scores = Critic(5)(torch.randn(2, 100, 3), torch.randn(2, 100, 2))
    assert scores.shape == (2, 13)


def test_a_chain_goes_as_the_training_did() -> None:
    """In one phase 0 1 2 0 1 2, in the other 3 3 3; what never followed is never drawn."""
    codes = np.array([0, 1, 2, 0, 1, 2, 0, 3, 3, 3])
    phase = np.array([0, 0, 0, 0, 0, 0, 0, 1, 1, 1])
    begins = np.zeros(10, dtype=np.bool_)
    begins[0] = True
    rng = np.random.default_rng(0)
    drawn = codes[drawn_chain(chain_of(codes, phase, begins), np.repeat([0, 1, 2], 20), rng)]
    assert np.all(np.diff(drawn[:20]) % 3 == 1) and {*drawn[:20].tolist()} == {0, 1, 2}
    assert np.all(drawn[20:40] == 3)
    assert {*drawn[40:].tolist()} <= {0, 1, 2, 3}


def test_a_chain_of_coin_tosses_keeps_their_odds() -> None:
    rng = np.random.default_rng(1)
    codes = (rng.random(4000) < 0.3).astype(np.intp)
    chain = chain_of(codes, np.zeros(4000, dtype=np.intp), np.arange(4000) == 0)
    drawn = codes[drawn_chain(chain, np.zeros(4000, dtype=np.intp), rng)]
    assert drawn.mean() == pytest.approx(0.3, abs=0.04)
