"""Each system learns what is known beforehand, and generates what belongs to a phase."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from learning_rigs.system_rig import PHASES, known, small

from benchmarks.paper.system import Batch, SystemModel, SystemPreset, begun, roles
from benchmarks.paper.tables import NAMES, printed
from benchmarks.paper.trainings import SYSTEMS
from learning.data.flights import ResidualFlight
from learning.evaluation import errors
from twin.errors import ModelError

AWAY = known(9)
EPOCHS = {
    **dict.fromkeys(("vqvae", "vqwwvae", "tdm", "timeddpm"), 150),
    **{"vqgan": 120, "cvae": 60},
}
"""To learn the waves; 30 for the others."""
FAST: dict[str, dict[str, float]] = {
    **{n: {"learning_rate": 3e-3} for n in SYSTEMS if n not in ("vqvae", "vqwwvae")},
    "vqgan": {"learning_rate": 2e-3},
    "tdm": {"learning_rate": 4e-3, "batch": 8},
    "timeddpm": {"learning_rate": 4e-3, "batch": 8},
}
"""Presets by which the waves are learned in a third of the steps."""
DRAWN = {"tsgan": 100, "wgan": 20}
"""Epochs to learn what belongs to a phase, 60 for the others; those that draw by what they learned
of the waves need none."""
SWINGING = ("cgan",)
"""Against a critic alone it swings about what it is to draw: of 14 settings and seeds one had draws
that were nearer to their own phase by a tenth."""
AUTOENCODERS = [n for n, system in SYSTEMS.items() if system.autoencoder]
SMOKE = "cvae"
"""Learns and draws in every run; the others, which take minutes, in `make test-long`."""
SOME = ("cvae", "vqgan", "timeddpm", "wgan")
"""One of each kind: a variational one, a codebook with a critic, a diffusion, critics alone."""
BY_CRITIC = ("wgan", "tsgan")
"""Without a term that says how far off a residual is."""


@pytest.fixture(scope="module")
def model(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> SystemModel:
    """A system that reconstructs."""
    name: str = request.param
    folder = tmp_path_factory.mktemp(name)
    return small(name, "reconstruct", EPOCHS.get(name, 30), folder, **FAST.get(name, {}))


@pytest.mark.slow
@pytest.mark.parametrize(
    "model",
    [
        n if n == SMOKE else pytest.param(n, marks=pytest.mark.long)
        for n in SYSTEMS
        if n not in BY_CRITIC
    ],
    indirect=True,
)
def test_a_known_sequence_is_learned(model: SystemModel, tmp_path: Path) -> None:
    """What is left of another flight is a tenth of what is left after one epoch, and less."""
    name = model.system.preset.name
    begun = small(name, "reconstruct", 1, tmp_path / "begun", **FAST.get(name, {}))
    left, before = (np.mean((AWAY.residual - m.run(AWAY).correction) ** 2) for m in (model, begun))
    assert left < 0.1 * before


def test_every_system_stands_in_the_paper() -> None:
    rows = {row for table, row, *_ in printed() if table == "II"} - {"Proposed"}
    assert {*NAMES.values()} == rows and len(SYSTEMS) == 13
    for system in SYSTEMS.values():
        assert {"reconstruct", "generate"} <= {*roles(system)}


def _apart(away: ResidualFlight, drawn: np.ndarray, phase: int, from_phase: int) -> float:
    """Mean distance of what is drawn in a phase from what a phase of a flight has."""
    own, other = drawn[away.phase == phase], away.residual[away.phase == from_phase]
    return float(
        np.mean([errors(a, b)["wasserstein"] for a, b in zip(own.T, other.T, strict=True)])
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    "model",
    [n if n == SMOKE else pytest.param(n, marks=pytest.mark.long) for n in AUTOENCODERS],
    indirect=True,
)
def test_draws_of_an_autoencoder_belong_to_their_phase(model: SystemModel) -> None:
    _check_draws(model, AWAY)


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    [
        pytest.param(n, marks=pytest.mark.long)
        for n in SYSTEMS
        if n not in (*AUTOENCODERS, *SWINGING)
    ],
)
def test_draws_belong_to_their_phase(name: str, tmp_path: Path) -> None:
    _check_draws(small(name, "generate", DRAWN.get(name, 60), tmp_path), AWAY)


@pytest.mark.parametrize("name", SWINGING)
def test_draws_change_with_the_phase(name: str, tmp_path: Path) -> None:
    """The same noise in another phase is another draw, and in the same one the same."""
    model = small(name, "generate", 5, tmp_path).with_seed(1)
    takeoff, hover = PHASES
    swapped = replace(AWAY, phase=np.where(AWAY.phase == takeoff, hover, takeoff))
    one, other = (model.run(flight).correction for flight in (AWAY, swapped))
    apart = np.abs(one - other).max(axis=1)
    assert np.all(apart > 1e-3 * np.std(one))
    np.testing.assert_array_equal(model.run(AWAY).correction, one)


def _check_draws(model: SystemModel, away: ResidualFlight) -> None:
    """Nearer to what their own phases have than to the others; another seed draws others."""
    one, again, other = (model.with_seed(k).run(away).correction for k in (1, 1, 2))
    np.testing.assert_array_equal(one, again)
    assert not np.array_equal(one, other)
    takeoff, hover = PHASES
    own = _apart(away, one, takeoff, takeoff) + _apart(away, one, hover, hover)
    assert own < 0.9 * (_apart(away, one, takeoff, hover) + _apart(away, one, hover, takeoff))


def test_what_reconstructs_against_a_critic_draws_nothing(tmp_path: Path) -> None:
    model = small("wgan", "reconstruct", 1, tmp_path)
    with pytest.raises(ModelError, match="Train it with the role generate"):
        model.with_seed(1)


@pytest.mark.parametrize(
    "name",
    ["wgan", *(pytest.param(n, marks=pytest.mark.long) for n in ("vqgan", "mrgan"))],
)
def test_a_training_that_was_cut_off_ends_with_the_same_bytes(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Players, optimisers and noise go on where they were."""
    from benchmarks.paper import system as players

    whole = small(name, "reconstruct", 4, tmp_path / "whole")
    monkeypatch.setattr(players, "CHECKPOINT_S", 0.0)
    epoch, seen = players._epoch, []

    def cut(*arguments: object) -> dict[str, float]:
        seen.append(arguments)
        if len(seen) == 3:
            raise KeyboardInterrupt
        return epoch(*arguments)  # type: ignore[arg-type]

    monkeypatch.setattr(players, "_epoch", cut)
    with pytest.raises(KeyboardInterrupt):
        small(name, "reconstruct", 4, tmp_path / "cut")
    monkeypatch.setattr(players, "_epoch", epoch)
    again = small(name, "reconstruct", 4, tmp_path / "cut")
    weights = again.system.state_dict()
    for key, values in whole.system.state_dict().items():
        assert torch.equal(values, weights[key]), key
    np.testing.assert_array_equal(whole.expected, again.expected)


@pytest.mark.parametrize(
    "name", [n if n in SOME else pytest.param(n, marks=pytest.mark.long) for n in SYSTEMS]
)
def test_a_system_works_on_the_device_that_it_is_moved_to(name: str) -> None:
    """A device without memory refuses whatever is still on the processor, as a GPU would."""
    system = begun(SYSTEMS[name], SystemPreset(name), "reconstruct", 0).to("meta")

    def some(n: int) -> torch.Tensor:
        return torch.zeros(2, 40, n, device="meta")

    batch = Batch(some(15), some(system.n_phases), some(15), some(15), done=0.9)
    for player in dict.fromkeys(system.turns(0.9)):
        loss = system.loss(player, batch)
        loss.backward(inputs=list(system.players()[player].parameters()))  # type: ignore[no-untyped-call]
        system.after_step(player)
        assert loss.device.type == "meta"
    assert system.reconstruct(batch.given, batch.phase).device.type == "meta"


@pytest.mark.parametrize("name", SYSTEMS)
def test_whatever_says_it_does_not_see_ahead_does_not(name: str) -> None:
    """A later sample changes nothing that was said before."""
    if SYSTEMS[name].sees_ahead:
        assert "track" not in roles(SYSTEMS[name])
        return
    torch.manual_seed(0)
    system = begun(SYSTEMS[name], SystemPreset(name), "reconstruct", 0).eval()
    given, phase = torch.randn(1, 40, 15), torch.zeros(1, 40, system.n_phases)
    later = given.clone()
    later[:, 30:] += 1.0
    said = []
    for each in (given, later):
        torch.manual_seed(1)
        with torch.no_grad():
            said.append(system.reconstruct(each, phase)[:, :30])
    torch.testing.assert_close(said[0], said[1], rtol=0, atol=1e-6)
    assert torch.isfinite(said[0]).all()
