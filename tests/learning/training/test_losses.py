"""Losses: each part against the formula written out."""

import pytest
import torch
from learning_rigs.residual_rig import tiny

from learning.data.channels import N_PHASES
from learning.model.network import ClusterNetwork, Latent, NetworkOut, Quantiser, SvqNetwork
from learning.preset import BEST, PAPER, PUBLISHED, Preset
from learning.training.losses import losses, moments_loss, quantiser_loss

CLUSTERS = (tuple(range(4)), tuple(range(4, 15)))


def latent(quantiser: Quantiser, z: torch.Tensor) -> Latent:
    found: Latent = quantiser(z)[1]
    return found


@pytest.fixture(autouse=True)
def _seeded() -> None:
    torch.manual_seed(0)


@pytest.mark.parametrize("target", ["soft", "nearest"])
def test_quantiser_loss(target: str) -> None:
    preset = tiny(codebook_target=target, beta=0.25)
    quantiser = Quantiser(preset)
    z = torch.randn(2, 5, 4)
    found = latent(quantiser, z)
    distance = {
        "soft": ((z - found.code) ** 2).mean(),
        "nearest": ((z - quantiser.codes[found.logits.argmax(-1)]) ** 2).mean(),
    }[target]
    torch.testing.assert_close(quantiser_loss(found, quantiser.codes, preset), 1.25 * distance)


def test_beta_weighs_the_pull_on_the_latent() -> None:
    pulls = {}
    for beta in (0.1, 1.0):
        preset = tiny(codebook_target="nearest", beta=beta)
        torch.manual_seed(1)
        quantiser = Quantiser(preset)
        z = torch.randn(30, 4, requires_grad=True)
        torch.autograd.backward(quantiser_loss(latent(quantiser, z), quantiser.codes, preset))
        assert z.grad is not None and quantiser.codes.grad is not None
        pulls[beta] = float(z.grad.norm()), float(quantiser.codes.grad.norm())
    assert pulls[1.0][0] == pytest.approx(10 * pulls[0.1][0], rel=1e-4)
    assert pulls[1.0][1] == pytest.approx(pulls[0.1][1], rel=1e-4)


def test_moments_loss_sees_the_distribution_alone() -> None:
    y = torch.randn(4, 50, 15)
    ones = torch.ones_like(y)
    shuffled = y[:, torch.randperm(50)]
    assert float(moments_loss(shuffled, y, ones)) < 1e-5
    assert float(moments_loss(y + 0.5, y, ones)) == pytest.approx(0.5, rel=1e-4)
    about = y - y.mean((0, 1))
    expected = float(about.square().mean((0, 1)).sqrt().mean())
    assert float(moments_loss(2 * about, about, ones)) == pytest.approx(expected, rel=1e-3)


def test_samples_that_do_not_count_do_not_count() -> None:
    preset = tiny(weight_quantiser=0.0)
    target, scored = torch.randn(2, 10, 15), torch.ones(2, 10, 15)
    scored[:, 5:] = 0
    out = NetworkOut(torch.randn(2, 10, 15), torch.zeros(2, 10, 15))
    wild = NetworkOut(out.y + 9 * (1 - scored), out.log_spread)
    quantisers = [Quantiser(preset) for _ in CLUSTERS]
    parts = [losses(o, target, scored, CLUSTERS, quantisers, preset) for o in (out, wild)]
    for name in ("reconstruction", "distribution", "spread"):
        torch.testing.assert_close(parts[0][name], parts[1][name])
    error = (out.y - target)[:, :5] ** 2
    expected = error[..., :4].mean() + error[..., 4:].mean()  # each cluster's own mean
    torch.testing.assert_close(parts[0]["reconstruction"], expected)


def test_weights_scale_their_parts_and_none_is_nought() -> None:
    target, scored = torch.randn(2, 10, 15), torch.ones(2, 10, 15)
    quantisers = [Quantiser(tiny()) for _ in CLUSTERS]
    latents = tuple(latent(q, torch.randn(2, 10, 4)) for q in quantisers)
    out = NetworkOut(torch.randn(2, 10, 15), torch.zeros(2, 10, 15), latents)
    weights = {"weight_reconstruction": 2.0, "weight_quantiser": 3.0, "weight_distribution": 4.0}
    ones = losses(out, target, scored, CLUSTERS, quantisers, tiny(**dict.fromkeys(weights, 1.0)))
    more = losses(out, target, scored, CLUSTERS, quantisers, tiny(**weights))
    for name, weight in weights.items():
        part = name.removeprefix("weight_")
        torch.testing.assert_close(more[part], weight * ones[part])
    off = tiny(quantiser="none", weight_distribution=0.0, spread_head=False)
    parts = losses(out, target, scored, CLUSTERS, quantisers, off)
    assert [name for name, part in parts.items() if float(part)] == ["reconstruction"]


def test_spread_is_least_at_the_size_of_the_error() -> None:
    """And it pulls at no other output."""
    preset = tiny(quantiser="none", weight_distribution=0.0)
    y = torch.randn(4, 100, 15, requires_grad=True)
    log_spread = torch.zeros(15, requires_grad=True)
    out = NetworkOut(y, log_spread.expand(4, 100, 15))
    target = y.detach() + 0.1 * torch.randn(4, 100, 15)
    loss = losses(out, target, torch.ones_like(y), CLUSTERS, [], preset)["spread"]
    loss.backward()  # type: ignore[no-untyped-call]
    assert log_spread.grad is not None and bool((log_spread.grad > 0).all())  # 1 is too wide
    assert y.grad is None or not bool(y.grad.any())


@pytest.mark.slow
@pytest.mark.parametrize("preset", [PAPER, PUBLISHED, BEST], ids=lambda p: p.name)
def test_network_and_losses_are_on_the_device_that_they_are_moved_to(preset: Preset) -> None:
    """A device without memory refuses whatever is still on the processor, as a GPU would."""
    network = SvqNetwork(preset, "reconstruct", CLUSTERS, 0).to("meta")

    def some(*shape: int) -> torch.Tensor:
        return torch.zeros(*shape, device="meta")

    seen = some(2, 9, 15), some(2, 9, 0), some(2, 9, N_PHASES)
    out, state = network(*seen, some(2, network.state_size))
    codebooks = [n.quantiser for n in network.networks if isinstance(n, ClusterNetwork)]
    found = losses(out, some(2, 9, 15), some(2, 9, 15), CLUSTERS, codebooks, preset)
    torch.autograd.backward(torch.stack(list(found.values())).sum())
    assert {part.device.type for part in (*found.values(), state)} == {"meta"}
