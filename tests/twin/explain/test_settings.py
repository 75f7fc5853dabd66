"""Settings: each says what it is, every other number of the search says why it is none, and what
is given to a search reaches all of it."""

import ast
import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

import twin.explain
from twin.errors import ModelError
from twin.explain import settings as package
from twin.explain.settings import DEFAULT, SearchSettings

ROOM = Path(next(iter(twin.explain.__path__)))
EVERY = {s.name: s for s in DEFAULT.every()}

LOCAL = {
    "a digit or a line that is shown": {
        "explanation.DIGITS",
        "unnamed.DIGITS",
        "estimates.MOST_RIVALS",
        "holdout.MOST",
        "holdout.BANDS_HZ",
    },
    "units": {
        "inference.sparse_regression.RAISED",
        "inference.sparse_regression.SPEED",
        "inference.sparse_regression.TURNING",
    },
    "channels, by definition or chosen from the table of sensors": {
        "model.factors.DERIVED_BAND_HZ",
        "inference.spectrum.OF_POSE",
        "inference.spectrum.OF_POSE_HZ",
        "model.factors.POSE_PASSES",
        "model.factors.SHARE_OF_RATE",
        "holdout.READINGS",
        "stochastic.search.SLOW_HZ",
        "stochastic.search.PLACEHOLDERS",
    },
    "steps, tries and tolerances of a solver": {
        "model.model.AGE_STEP_S",
        "model.model.BEND_S",
        "model.model.SMALL",
        "model.numbers.STEPS",
        "model.factors.AGE_S",
        "inference.instruments.BLOCK",
        "inference.search.NO_CHECKPOINT",
        "model.prediction.DRIVEN",
        "model.prediction.REMEMBERED",
        "calibration.AT_FILE",
        "inference.priors.EDGE",
        "model.model.RECENT",
        "inference.adequacy.LEAST",
        "inference.adequacy.UNKNOWN_POWER",
        "inference.evidence.HALVINGS",
        "inference.evidence.PIVOTS",
        "inference.evidence.SETTLED",
        "inference.evidence.STEPS",
        "inference.fit.ACQUAINTED",
        "inference.fit.FARTHER",
        "inference.fit.INEXACT",
        "inference.fit.LONG",
        "model.prediction.FUNCTIONS",
        "inference.fit.FARTHEST_S",
        "inference.fit.FARTHEST_POSE_S",
        "inference.fit.ARMIJO",
        "inference.fit.MARGIN",
        "inference.fit.ROUNDS",
        "inference.fit.SETTLED",
        "inference.fit.SHORTEST_STEP",
        "inference.fit.STRAIGHT",
        "inference.search.AHEAD",
        "inference.search.FEW",
        "inference.search.MOVES",
        "inference.search.RIVALS",
        "inference.search.SHORT",
        "inference.search.TRIED",
        "inference.search.MIN_GAIN",
        "inference.search.CLEAR",
        *(
            f"inference.valley.{n}"
            for n in ("SIZES", "PIVOT", "SHAPES", "PARTNERS", "BALANCING", "STARTS", "LEAST")
        ),
        "inference.posterior.PRUNE_BELOW",
        "inference.posterior.PRUNE_ABOVE",
        "inference.posterior.PRUNE_AFTER",
        "inference.posterior.SWEEPS",
        "inference.posterior.WINDOW",
        "inference.selection.DAYS_SHOWN",
        "inference.selection.MANY",  # where a search begins
        "holdout.DRAWS",
        "inference.sparse_regression.RIDGE",
        "unnamed.FINER",
        "stochastic.search.RIDGES",
        "stochastic.search.NO_NOISE",
    },
    "what is believed before any flight, besides the table of priors": {
        "inference.noise.FAST_RAD_S",
        "inference.fit.KAPPAS",
        "inference.fit.BEFORE",
    },
    "frequencies in which channels are taken apart": {
        "inference.instruments.LOOP_HZ",
        "inference.noise.CORNERS_HZ",
        "inference.instruments.SLOWEST",
        "inference.setpoints.SHARPEST",
        "inference.setpoints.SLOW_HZ",
        "inference.setpoints.SLOWEST_WAY_M_S",
        "inference.spectrum.BANDS_HZ",
        "inference.spectrum.SHORTEST",
    },
    "reported numbers and sets, once their probability is known": {
        "inference.fit.COVERED",
        "inference.posterior.EXCHANGED",
        "calibration.CLEARLY",
        "inference.selection.APART",
        "inference.valley.MORE",
        "estimates.UNDETERMINED",
        "inference.estimate.MOST_OF_PRIOR",
        "stochastic.search.LAG_S",
        "stochastic.search.SMALLEST_DRAG_1_S",
    },
    "which setpoints tell of an aircraft: tests of an instrument, with their sources": {
        "inference.instruments.ALIKE",
        "inference.instruments.ANSWERED",
        "inference.instruments.CHANCE",
        "inference.instruments.DELAYS_S",
        "inference.instruments.F_LEAST",
        "inference.instruments.FOLLOWED",
        "inference.instruments.GAINS",
        "inference.instruments.INEXACT",
        "inference.instruments.LAGS_S",
        "inference.instruments.TESTED",
        "inference.instruments.UNEVEN",
        "inference.setpoints.ALIKE",
        "inference.setpoints.FEWEST",
    },
    "the balance of forces and moments, chosen on one aircraft (docs/dev/decisions/balance.md)": {
        f"balance.{n}"
        for n in (
            "ALONE",
            "DAY",
            "FACTORS",
            "LOG_ODDS",
            "REACH",
            "ROPE",
            "SECOND_ROTOR",
            "SESSION",
            "SHAKEN",
            "SHAKEN_LEAST_HZ",
            "SHAKEN_SD",
            "SHAKES",
            "SHAKES_ABOVE_HZ",
            "SIZES",
            "STEADY_SD",
            "SUSPECT",
        )
    },
    "by how much a wind is stronger than usual (twin/explain/weather.py)": {"weather.STRONG"},
    "from which lengths a rope is sought (twin/explain/weather.py)": {"weather.ROPES"},
    "a prior of physics: what it is, stands beside it": {
        "inference.evidence.GYRO_S",
        "inference.evidence.TAIL_DEGREES",
        "inference.priors.PROPELLERS",
        "inference.selection.UNKNOWN_CONSTANT",
    },
    "where the part of a long flight that is read may begin": {"usable.BLOCK_S"},
    "how many columns are held in memory at a time": {"model.model.SLOPES_AT_ONCE"},
    "how numbers are rounded": {
        "inference.evidence.LEAST_EIGENVALUE",
    },
    "mathematics": {
        "inference.fit.INTERVAL",  # 95 % intervals
        "inference.detection.POWER_95",
        "inference.estimate._CREDIBLE",
        "inference.whitening._FAR",
        "stochastic.imu_noise.LOG_MEAN",
        "stochastic.imu_noise.LOG_SD",
    },
    "what is shown of a result, after its verdict": {
        "holdout.ABOVE_FLOOR",
        "holdout.BINS",
        "holdout.FEWEST_SAMPLES",
        "holdout.LEAST_EXPLAINED",
        "holdout.LEAST_SHARE",
        "holdout.STRONG_SHARE",
    },
    "what is shown of a suggested flight": {"design.ENOUGH_NAT"},
    "what matters of a sensor, which its row in the table of sensors says": {
        "unnamed.SMALLEST",
    },
}
"""Numbers that decide no verdict, or belong to another definition, by the reason."""


def modules() -> Iterator[tuple[str, ast.Module]]:
    for path in sorted(ROOM.rglob("*.py")):
        name = ".".join(path.relative_to(ROOM).with_suffix("").parts)
        yield name, ast.parse(path.read_text("utf-8"))


# -- what is written down -------------------------------------------------------------------


def test_each_setting_says_what_it_is_and_where_it_comes_from(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.syspath_prepend(str(Path(__file__).parents[3] / "docs" / "_generate"))
    import tables

    told = {name: (meaning, origin) for name, _, meaning, origin in tables.told_settings()}
    assert [*told] == [*EVERY]
    for name, (meaning, origin) in told.items():
        assert len(meaning.split()) >= 3, name
        assert "|" not in meaning + origin  # they stand in a table


def numeric(value: ast.expr) -> bool:
    """Whether an expression holds numbers, or is made of other constants that do."""
    nodes = list(ast.walk(value))
    text = any(isinstance(n, ast.Constant) and isinstance(n.value, str) for n in nodes)
    number = any(isinstance(n, ast.Constant) and isinstance(n.value, int | float) for n in nodes)
    return number or (any(isinstance(n, ast.Call) for n in nodes) and not text)


@pytest.mark.slow
def test_every_other_number_of_the_search_says_why_it_is_no_setting() -> None:
    found = set()
    for module, tree in modules():
        for node in tree.body:
            targets = node.targets if isinstance(node, ast.Assign) else []
            targets = [node.target] if isinstance(node, ast.AnnAssign) else targets
            names = [n.id for t in targets for n in ast.walk(t) if isinstance(n, ast.Name)]
            value = getattr(node, "value", None)
            if names and value is not None and names[0].isupper() and numeric(value):
                found |= {f"{module}.{n}" for n in names}
    found -= {"settings.DEFAULT"}
    allowed = set().union(*LOCAL.values())
    assert found - allowed == set()  # make it a setting, or say here why it is none
    assert allowed - found == set()  # what is no longer there


# -- changing them --------------------------------------------------------------------------


def test_changed_settings_are_told_and_change_the_hash() -> None:
    name = "inference.selection.sure"
    other = DEFAULT.with_values({name: 0.9, "stochastic.one_of": 40.0})
    assert other.inference.selection.sure == 0.9
    assert dict(other.changed) == {name: 0.9}
    assert DEFAULT.changed == {}
    assert other.hash != DEFAULT.hash == SearchSettings().hash
    assert other.with_values({name: EVERY[name].value}) == DEFAULT


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("inference.selection.sure", 1.0, "SelectionSettings.sure = 1.0: .* below 1"),
        ("inference.likelihood.huber", 0.0, "above 0"),
        ("inference.likelihood.huber", math.nan, "finite"),
        ("inference.likelihood.huber", (1.0, 2.0), "as many numbers"),
        ("inference.likelihood.order", 2.5, "whole number"),
        ("stochastic.gust.band_hz", (3.0, 0.1), "do not fall"),
        ("selection.sure", 0.9, "no setting 'selection.sure'; is inference.selection.sure meant"),
        ("inference.selection", 0.9, "no setting 'inference.selection'"),
    ],
)
def test_values_that_make_no_sense_are_refused(name: str, value: float, words: str) -> None:
    with pytest.raises(ModelError, match=words):
        DEFAULT.with_values({name: value})


# -- handing them down ----------------------------------------------------------------------

GROUPS = {n for n in vars(package) if n.endswith("Settings")}


def takers() -> dict[str, tuple[str, int]]:
    """Callable -> name and place of its settings, which it can do without."""
    found = {}
    for module, tree in modules():
        if module in ("settings", "setting_group"):
            continue
        classes = [n for n in ast.walk(tree) if isinstance(n, ast.ClassDef)]
        owner = {id(f): c.name for c in classes for f in c.body}
        for node in ast.walk(tree):
            if not isinstance(node, ast.FunctionDef):
                continue
            every = node.args.args
            for place, argument in enumerate(every):
                kind = ast.unparse(argument.annotation) if argument.annotation else ""
                if kind in GROUPS and place >= len(every) - len(node.args.defaults):
                    inside = owner.get(id(node))
                    name = {"__init__": inside, "of": f"{inside}.of"}.get(node.name, node.name)
                    assert name is not None
                    found[name, argument.arg] = place - (inside is not None)
    by_name: dict[str, tuple[str, int]] = {}
    for (taker, handed), place in found.items():
        by_name.setdefault(taker, (handed, place))
    return by_name


@pytest.mark.slow
def test_no_part_of_the_search_forgets_to_hand_settings_down() -> None:
    known, calls = takers(), 0
    assert {
        "explain",
        "name_effects",
        "Problem.of",
        "BandNoise.of",
        "misfits",
    } <= set(known)
    for module, tree in modules():
        for node in ast.walk(tree):
            if not isinstance(node, ast.Call):
                continue
            name = ast.unparse(node.func)
            name = name if name in known else name.rpartition(".")[2]
            if name not in known or name == "log_posterior":
                continue
            argument, place = known[name]
            calls += 1
            given = len(node.args) > place or argument in {k.arg for k in node.keywords}
            assert given, f"{module}:{node.lineno}: {name} is called without {argument}"
    assert calls > 30


def test_values_in_bands_are_compared_as_they_stand() -> None:
    bands = np.array(DEFAULT.stochastic.noise_level.bands)
    assert np.all(bands[:, 0] < bands[:, 1])
    assert np.all(bands < 0.5)  # of the sample rate: no frequency lies beyond
