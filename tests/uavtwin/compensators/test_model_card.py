"""Model cards: a head that YAML reads, numbers of the JSON beside."""

import json
import re
from pathlib import Path
from typing import Any

import pytest
import yaml

from twin.errors import TwinError
from uavtwin.model_card import (
    FILE,
    UNSAID,
    Measured,
    card_text,
    check_license,
    table,
    write_card,
    write_completed_card,
    written_license,
)

CLAIM = "track, 2 samples (40 ms) ahead: something was learned."
FLIGHT = {"name": "one|two\n---\n# three", "sha256": "a1", "log_sha256": "b2", "samples": 9}
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
    match = re.match(r"---\n(.*?)\n---\n", text, re.DOTALL)
    content = yaml.safe_load(match[1]) if match else None
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
    assert cells(text, "flight")[2] == ["one\\|two --- # three", "9", "5.82", "b2"]
    assert cells(text, "input")[2:] == [["gyro_x", "1.00e\u221205", "0.25"]]
    assert cells(text, "channel")[2:] == [["acc_x", "0.5", "0.25"], ["acc_y", "0.5", "0.5"]]
    limits = text.split("## Limits")[1]
    assert "adds nothing to the linear prediction in acc_y:" in limits
    assert "No reading in the training: mag_x." in limits
    assert "Nothing is known yet" in limits


def test_evaluation_completes_it_with_the_numbers_of_its_json(folder: Path, tmp_path: Path) -> None:
    write_card(folder, CLAIM, "cc-by-4.0")
    before = (folder / FILE).read_bytes()
    assert write_completed_card(folder, CLAIM, MEASURED, tmp_path) == FILE
    assert (folder / FILE).read_bytes() == before
    text = (tmp_path / FILE).read_text("utf-8")
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


@pytest.mark.slow
@pytest.mark.parametrize(
    ("text", "license"),
    [
        ("# No head\n", UNSAID),
        ("---\ntags: [a]\n---\n# T\n", UNSAID),
        ("---\nlicense: mit\n---\n", "mit"),
        ("---\nlicense: [1, 2]\n---\n", None),
        ("---\nlicense: 'x y'\n---\n", None),
        ("---\n{{{: :\n---\n", None),
        ("---\n" + "[" * 20_000 + "\n---\n", None),
    ],
)
def test_the_licence_is_read_off_a_card_that_anybody_may_have_edited(
    text: str, license: str | None, tmp_path: Path
) -> None:
    (tmp_path / FILE).write_text(text, "utf-8")
    if license is None:
        with pytest.raises(TwinError, match=r"README.md: its head cannot be read"):
            written_license(tmp_path / FILE)
    else:
        assert written_license(tmp_path / FILE) == license
    assert written_license(tmp_path / "none.md") == UNSAID


def test_a_learned_force_has_one_too(tmp_path: Path) -> None:
    outputs = {
        "force_x": {"law": "none", "ridge": None},
        "moment_y": {"law": "linear", "ridge": 0.3},
    }
    about = {
        **{"protocol": "force", "vehicle": "copter", "vehicle_sha256": "c3", "seed": 0},
        **{"flights": [{"name": "one", "sha256": "b2"}], "outputs": outputs},
        "acceptance": {"refused": True, "fast": 1.2},
        "closed_loop": {"flights": 4, "lost": 1, "withdrawn": 2, "unsteady": 1},
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
    assert "Missions were lost with 2 better laws: withdrawn." in limits
    assert "Refused: the untrained observer alone is as good." in limits
    assert "On fast flights the last motion is closer" in limits
    assert "moment_y linear, ridge 0.3, none" in text
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
