"""The sentence where a propeller is damaged and the flights do not tell which."""

import pytest

from twin.explain.balance import LOAD, NOTHING, ROTORS, VIBRATION, Balance, Hypothesis
from uavtwin.explain_record import _one_of
from uavtwin.headline import _of_balance


def damage(chances: dict[int, float], shakes: float) -> Balance:
    """Single rotors with their probabilities, the rest of it a load."""
    name = f"{ROTORS}.loss_"
    left = 1 - shakes - sum(chances.values())
    every = [
        *(
            Hypothesis(ROTORS, (i,), p, {f"{name}{i}": 0.1}, {f"{name}{i}": 0.02})
            for i, p in chances.items()
        ),
        Hypothesis(VIBRATION, (), shakes, {}, {}),
        Hypothesis(LOAD, (), left, {f"{LOAD}.mass_kg": 0.1}, {f"{LOAD}.mass_kg": 0.1}),
        Hypothesis(NOTHING, (), 0.0, {}, {}),
    ]
    every.sort(key=lambda h: -h.probability)
    return Balance(tuple(every), {}, (0.0,) * 8, 0.8)


@pytest.mark.parametrize(
    ("chances", "shakes", "words", "rotors"),
    [
        (
            {2: 0.55, 5: 0.27, 7: 0.04},
            0.12,
            "rotor 2 has lost 10 % of its thrust (55 %), rotor 5 has lost 10 % of its thrust "
            "(27 %) or one vibrates and none has lost thrust (12 %)",
            [(2,), (5,), None],
        ),
        ({2: 0.05}, 0.93, "one vibrates and none has lost thrust (93 %)", [None]),
    ],
)
def test_a_damaged_propeller_that_may_be_one_of_some(
    chances: dict[int, float], shakes: float, words: str, rotors: list[tuple[int, ...] | None]
) -> None:
    balance = damage(chances, shakes)
    assert balance.named is None
    text = _of_balance(balance)
    assert text.startswith("a propeller is damaged (98 %): ")
    assert text.endswith(f": {words}. These flights cannot tell which.")
    assert [r.rotor for r in _one_of(balance)] == rotors


def test_a_rotor_that_is_sure_is_named() -> None:
    named = damage({2: 0.92, 5: 0.04}, 0.02).named
    assert named is not None
    assert (named.cause, named.rotors, named.probability) == (ROTORS, (2,), 0.92)


def test_a_load_that_is_fixed_or_hangs_on_a_rope() -> None:
    rope = {"slung_load.mass_kg": 0.1, "slung_load.length_m": 0.5}
    hanging = Hypothesis("slung_load", (), 0.3, rope, {n: 0.01 for n in rope})
    mass = {f"{LOAD}.mass_kg": 0.1}
    load = Hypothesis(LOAD, (), 1.0, mass, {n: 0.01 for n in mass})
    none = [Hypothesis(c, (), 0.0, {}, {}) for c in (ROTORS, NOTHING)]
    balance = Balance((load, *none), {}, (0.0,) * 8, 0.8, hanging)
    assert _of_balance(balance) == (
        "it carries 0.1 kg more (70 %) or a load of 0.1 kg hangs below it on a rope (30 %). "
        "These flights cannot tell which."
    )
    assert [(r.cause, r.probability) for r in _one_of(balance)] == [
        (LOAD, 0.7),
        ("slung_load", 0.3),
    ]
