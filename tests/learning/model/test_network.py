"""Network: states carry on, soft code to hard, gradients where the switches say."""

from itertools import pairwise

import pytest
import torch
from learning_rigs.residual_rig import tiny
from torch import Tensor

from learning.data.channels import CHANNELS, N_PHASES
from learning.data.clustering import Clusters
from learning.model.network import LstmStack, Quantiser, SvqNetwork

CLUSTERS: Clusters = ((0, 4, 5, 14), tuple(c for c in range(1, 14) if c not in (4, 5)))
N_FEATURES = 3


def inputs(batch: int, time: int) -> tuple[Tensor, Tensor, Tensor]:
    phases = torch.randint(N_PHASES, (batch, time))
    return (
        torch.randn(batch, time, len(CHANNELS)),
        torch.randn(batch, time, N_FEATURES),
        torch.nn.functional.one_hot(phases, N_PHASES).float(),
    )


def stirred(module: torch.nn.Module) -> None:
    """No weight is zero, as after some training."""
    for parameter in module.parameters():
        parameter.data += 0.1 * torch.randn_like(parameter)


@pytest.fixture(autouse=True)
def _seeded() -> None:
    torch.manual_seed(0)


@pytest.mark.parametrize("protocol", ["reconstruct", "track", "free"])
@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"skip": False, "spread_head": False, "encoder_units": (5, 7), "decoder_units": (6, 3)},
        {"quantiser": "hard"},
        {"quantiser": "none"},
    ],
)
@torch.no_grad()
def test_a_state_carries_a_sequence_on(protocol: str, changes: dict[str, object]) -> None:
    """To the rounding of float32: in two halves, and sample by sample."""
    network = SvqNetwork(tiny(**changes), protocol, CLUSTERS, N_FEATURES)  # type: ignore[arg-type]
    stirred(network)
    known, features, phase = inputs(2, 12)
    zero = torch.zeros(2, network.state_size)
    whole, end = network(known, features, phase, zero)
    for cuts in ([0, 5, 12], range(13)):
        state = zero
        for a, b in pairwise(cuts):
            out, state = network(known[:, a:b], features[:, a:b], phase[:, a:b], state)
            for name in ("y", "log_spread"):
                expected = getattr(whole, name)[:, a:b]
                torch.testing.assert_close(getattr(out, name), expected, atol=1e-6, rtol=1e-6)
        torch.testing.assert_close(state, end, atol=1e-6, rtol=1e-6)


@torch.no_grad()
def test_lstm_against_an_independent_cell() -> None:
    stack = LstmStack(4, [6])
    cell = torch.nn.LSTMCell(4, 6)
    layer = stack.layers[0]
    assert isinstance(layer, torch.nn.LSTM)
    cell.load_state_dict({k.removesuffix("_l0"): v for k, v in layer.state_dict().items()})
    x, state, (h, c) = torch.randn(3, 4), torch.randn(3, 12), (torch.zeros(0), torch.zeros(0))
    h, c = cell(x, (state[:, :6], state[:, 6:]))
    out, after = stack(x[:, None], state)
    torch.testing.assert_close(out[:, 0], h, atol=1e-6, rtol=1e-6)
    torch.testing.assert_close(after, torch.cat([h, c], dim=1), atol=1e-6, rtol=1e-6)


@torch.no_grad()
def test_soft_code_becomes_the_nearest_as_the_temperature_falls() -> None:
    z = torch.randn(50, 4)
    hard = Quantiser(tiny(quantiser="hard"))
    nearest = hard(z)[1].code
    gaps = []
    for temperature in (1.0, 0.1, 1e-4):
        soft = Quantiser(tiny(temperature=temperature))
        soft.codes.copy_(hard.codes)
        gaps.append(float((soft(z)[1].code - nearest).abs().median()))
    assert gaps[0] > gaps[1] > gaps[2]
    assert gaps[2] < 1e-6


@torch.no_grad()
def test_hard_assignment_is_the_nearest_code() -> None:
    quantiser = Quantiser(tiny(quantiser="hard"))
    z = torch.randn(20, 4)
    distances = torch.cdist(z, quantiser.codes)
    _, latent = quantiser(z)
    torch.testing.assert_close(latent.code, quantiser.codes[distances.argmin(1)])


@pytest.mark.parametrize(
    ("changes", "to_codes", "to_latent"),
    [
        ({}, True, True),
        ({"straight_through": True}, False, True),
        ({"quantiser": "hard"}, False, True),
        ({"quantiser": "none"}, False, True),
    ],
)
def test_gradient_of_the_reconstruction(
    changes: dict[str, object], to_codes: bool, to_latent: bool
) -> None:
    quantiser = Quantiser(tiny(**changes))
    z = torch.randn(10, 4, requires_grad=True)
    quantiser(z)[0].square().sum().backward()
    assert (quantiser.codes.grad is not None and bool(quantiser.codes.grad.any())) is to_codes
    assert (z.grad is not None and bool(z.grad.any())) is to_latent


@torch.no_grad()
def test_response_is_the_slope_of_the_code() -> None:
    """Against central differences of the quantiser itself."""
    quantiser = Quantiser(tiny())
    quantiser.codes.add_(0.3)
    steps = 0.05 * torch.eye(4)
    slope = (quantiser(steps)[1].code - quantiser(-steps)[1].code) / 0.1
    torch.testing.assert_close(slope.T, quantiser.response(), atol=2e-3, rtol=2e-3)


@torch.no_grad()
def test_reconstruction_starts_near_the_identity() -> None:
    """Small inputs come through the soft codebook before any training."""
    network = SvqNetwork(tiny(n_codes=64), "reconstruct", CLUSTERS, 0)
    four = list(CLUSTERS[0])  # as many channels as the code has numbers
    known, _, phase = inputs(1, 30)
    known = 0.3 * known
    out, _ = network(known, torch.zeros(1, 30, 0), phase, torch.zeros(1, network.state_size))
    left = (out.y - known)[..., four]
    assert float(left.square().mean().sqrt()) < 0.1 * float(known.square().mean().sqrt())


@torch.no_grad()
def test_free_looks_at_no_residual() -> None:
    network = SvqNetwork(tiny(), "free", CLUSTERS, N_FEATURES)
    stirred(network)
    known, features, phase = inputs(1, 8)
    state = torch.zeros(1, network.state_size)
    before = network(known, features, phase, state)[0].y
    torch.testing.assert_close(network(known + 1, features, phase, state)[0].y, before)


@torch.no_grad()
def test_phases_without_data_get_the_mean_embedding() -> None:
    network = SvqNetwork(tiny(), "free", CLUSTERS, N_FEATURES)
    seen = [p in (1, 2) for p in range(N_PHASES)]
    mean = network.phase_embedding[1:3].mean(0)
    network.fill_unseen(seen)
    torch.testing.assert_close(network.phase_embedding[4], mean)
    assert not torch.equal(network.phase_embedding[1], network.phase_embedding[2])
