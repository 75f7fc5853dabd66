"""Model cards: a head that YAML reads, numbers of the JSON beside, edits kept."""

import json
import math
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from twin.errors import TwinError
from uavtwin.model_card.card import FILE, card_text
from uavtwin.model_card.license import check_license
from uavtwin.model_card.markdown import table
from uavtwin.model_card.measured import Measured
from uavtwin.model_card.write import complete_card, write_card
from uavtwin.model_card.yaml_head import yaml_head

CLAIM = "track, 2 samples (40 ms) ahead: something was learned."
FLIGHT = {"name": "one|two\n# three", "sha256": "a1", "log_sha256": "b2", "samples": 9}
ABOUT: dict[str, Any] = {
    **{"family": "svq", "protocol": "track", "horizon": 2, "rate_hz": 50.0, "n_commands": 4},
    **{"channels": ["acc_x", "acc_y", "mag_x"], "units": ["m/s^2", "m/s^2", "T"]},
    **{"clusters": [["acc_x", "acc_y"], ["mag_x"]], "preset": {"name": "best"}, "seed": 3},
    **{"vehicle": "copter", "vehicle_sha256": "c3", "flights": [{**FLIGHT, "seconds": 5.82}]},
    "envelope": {"inputs": ["gyro_x"], "centre": [1e-5], "scale": [0.25], "whitening": [[1.0]]},
    "metrics": {
        "validation_mse": {
            "acc_x": {"linear": 0.5, "with_network": 0.25},
            "acc_y": {"linear": 0.5, "with_network": 0.5},
            "mag_x": {"linear": 0.0, "with_network": 0.0},
        }
    },
}


def group(name: str, model: str, rmse: float | None, unit: str = "m/s^2") -> dict[str, Any]:
    shares = {"within_1": 0.5, "within_2": 0.75, "inside": None}
    return {"group": name, "unit": unit, "model": model, "n": 7, "rmse": rmse, **shares}


EVALUATION = {
    "claim": "track: better for acc by 50 %; worse for mag by 10 %.",
    "flights": ["three"],
    "groups": [
        group("acc", "mean", 2.0),
        group("acc", "last", None),
        group("acc", "linear part alone", 0.5),
        group("acc", "model", 1.0000000000000002e-05),
        group("mag", "mean", 1e-7, "T"),
        group("mag", "last", 2e-7, "T"),
        group("mag", "linear part alone", 1e-7, "T"),
        group("mag", "model", 1.1e-7, "T"),
    ],
}
MEASURED = Measured(EVALUATION, {"three": "d4"})


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "model").mkdir()
    (tmp_path / "model" / "model.json").write_text(json.dumps(ABOUT))
    (tmp_path / "model" / "model.onnx").touch()
    return tmp_path / "model"


def head(text: str) -> dict[str, Any]:
    _, yaml_text, _ = text.split("---\n", 2)
    content = yaml.safe_load(yaml_text)
    assert isinstance(content, dict)
    return content


def cells(text: str, first: str) -> list[list[str]]:
    """The table whose header begins with a cell."""
    lines = text[text.index(f"| {first} |") :].splitlines()
    rows = []
    for line in lines:
        if not line.startswith("|"):
            break
        rows.append([c.strip() for c in line[1:-1].split(" | ")])
    return rows


SCALARS = st.one_of(
    st.text(), st.integers(), st.floats(allow_nan=False, allow_infinity=False), st.booleans()
)
KEYS = st.from_regex(r"[a-z][a-z_-]{0,8}", fullmatch=True).filter(
    lambda k: k not in ("on", "off", "yes", "no", "true", "false", "null", "n", "y")
)
NESTED = st.recursive(
    SCALARS,
    lambda inner: (
        st.dictionaries(KEYS, inner, max_size=3)
        | st.lists(SCALARS | st.dictionaries(KEYS, inner, min_size=1, max_size=3), max_size=3)
    ),
    max_leaves=8,
)


@settings(max_examples=25)
@given(st.dictionaries(KEYS, NESTED, max_size=4))
def test_yaml_reads_what_was_meant(content: dict[str, Any]) -> None:
    text = yaml_head(content)
    assert text.startswith("---") and text.endswith("---")
    read = yaml.safe_load(text.removeprefix("---").removesuffix("---")) or {}
    assert read == content


def test_the_card_of_a_training_tells_what_is_recorded(folder: Path) -> None:
    assert write_card(folder, CLAIM, "cc-by-4.0") == FILE
    text = (folder / FILE).read_text("utf-8")
    content = head(text)
    assert content["license"] == "cc-by-4.0" and content["library_name"] == "uavtwin"
    assert content["tags"] == ["digital-twin", "multirotor", "track", "svq", "onnx"]
    assert content["vehicle"] == {"name": "copter", "sha256": "c3"}
    (flight,) = content["training_flights"]
    assert flight["name"] == FLIGHT["name"] and flight["sha256"] == "b2"
    assert flight["residuals_sha256"] == "a1" and flight["seconds"] == 5.82
    assert "model-index" not in content
    assert CLAIM in text and "Not measured yet" in text
    assert cells(text, "flight")[2] == ["one\\|two # three", "9", "5.82", "b2"]
    assert cells(text, "input")[2:] == [["gyro_x", "1.00e\u221205", "0.25"]]
    assert cells(text, "channel")[2:] == [["acc_x", "0.5", "0.25"], ["acc_y", "0.5", "0.5"]]
    limits = text.split("## Limits")[1]
    assert "adds nothing to the linear prediction in acc_y:" in limits
    assert "No reading in the training: mag_x." in limits
    assert "Nothing is known yet" in limits


def test_evaluation_completes_it_with_the_numbers_of_its_json(folder: Path, tmp_path: Path) -> None:
    write_card(folder, CLAIM, "cc-by-4.0")
    assert complete_card(folder, CLAIM, MEASURED, tmp_path) == folder / FILE
    text = (folder / FILE).read_text("utf-8")
    content = head(text)
    assert content["license"] == "cc-by-4.0"  # kept
    (index,) = content["model-index"]
    (result,) = index["results"]
    assert result["dataset"] == {"type": "flights", "name": "three", "args": {"sha256": ["d4"]}}
    own = {g["group"]: g["rmse"] for g in EVALUATION["groups"] if g["model"] == "model"}  # type: ignore[index]
    assert [m["value"] for m in result["metrics"]] == [own["acc"], own["mag"]]
    assert [m["name"] for m in result["metrics"]] == ["acc, m/s^2", "mag, T"]
    shown = cells(text, "sensor")
    assert shown[0] == ["sensor", "unit", "mean", "last", "linear part alone", "model"]
    assert shown[2][2:4] == ["2", "\u2013"]
    limits = text.split("## Limits")[1]
    assert "mag: mean leaves 1.00e\u221207, it 1.10e\u221207 T" in limits
    assert "acc:" not in limits and "Nothing is known yet" not in limits
    complete_card(folder, CLAIM, MEASURED, tmp_path)  # again: our own card is replaced
    assert (folder / FILE).read_text("utf-8") == text


def test_a_card_that_was_edited_stays(folder: Path, tmp_path: Path) -> None:
    write_card(folder, CLAIM)
    edited = (folder / FILE).read_text("utf-8").replace("## Limits", "## Limits, by us")
    (folder / FILE).write_text(edited, "utf-8")
    out = tmp_path / "evaluation"
    out.mkdir()
    assert complete_card(folder, CLAIM, MEASURED, out) == out / FILE
    assert (folder / FILE).read_text("utf-8") == edited
    assert "model-index" in head((out / FILE).read_text("utf-8"))


def test_a_learned_force_has_one_too(tmp_path: Path) -> None:
    outputs = {
        "force_x": {"law": "linear", "network": True},
        "force_y": {"law": "none", "network": False},
    }
    about = {
        **{"protocol": "force", "vehicle": "copter", "vehicle_sha256": "c3", "seed": 0},
        **{"flights": [{"name": "one", "sha256": "b2"}], "outputs": outputs},
        "closed_loop": {"flights": 4, "lost": 1, "withdrawn": ["waves"]},
    }
    (tmp_path / "force.json").write_text(json.dumps(about))
    quantities = {"position": 0.1, "velocity": 0.2, "attitude": 0.3, "rates": 0.4}
    over = {"over_explained_median": 0.41, "over_explained_largest": 0.98}
    rows = [
        {"model": "corrected", "horizon_s": 0.5, **quantities, **over},
        {"model": "last motion", "horizon_s": 0.5, **quantities, "rates": 0.3, **over},
        {"model": "corrected", "horizon_s": 1.0, **dict.fromkeys(quantities, 9.0), **over},
    ]
    evaluation = {
        **{"claim": "far less off.", "flights": ["three"], "summary": rows},
        **{"inside": {"three": [1.0, 0.5]}, "horizons_s": [0.1, 0.5]},
    }
    text = card_text(tmp_path, "force: laws.", measured=Measured(evaluation, {"three": "d4"}))
    (result,) = head(text)["model-index"][0]["results"]
    assert [m["value"] for m in result["metrics"]] == [*quantities.values(), *over.values()]
    limits = text.split("## Limits")[1]
    assert "Withdrawn, as missions were lost with it: waves." in limits
    assert "No law for force_y." in limits
    assert "rates: last motion is off by 0.3, it by 0.4" in limits
    assert "nobody has said" in text and head(text)["license"] == "unknown"


def test_a_licence_is_an_identifier() -> None:
    assert check_license("cc-by-4.0") == "cc-by-4.0"
    for name in ("", "my licence", 'x"\nlibrary_name: y', "-x"):
        with pytest.raises(TwinError, match=r"give an identifier .* e\.g\. cc-by-4\.0"):
            check_license(name)


def test_no_text_leaves_its_cell() -> None:
    text = table(["a", "b"], [["x|y\nz", "<b>[l](u)`c`"]])
    assert text.splitlines()[2] == "| x\\|y z | \\<b\\>\\[l\\](u)\\`c\\` |"
    assert len(text.splitlines()) == 3


def test_what_is_not_defined_is_null() -> None:
    assert yaml.safe_load(yaml_head({"a": math.nan}).strip("-")) == {"a": None}
