"""`uavtwin train` and `uavtwin evaluate` on short flights: files, pages, errors, going on."""

import json
import re
import stat
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import fmpy
import numpy as np
import pandas as pd
import pytest
import torch
import yaml
from page_rigs.browser import VIEWS, browser, faults, needs_browser, pictures, tables_cut
from page_rigs.figures import figures_of

from learning.data.channels import CHANNELS
from learning.data.flights import residual_flight
from learning.model.family import TrainedModel
from learning.model.folder import load
from learning.training.checkpoint import CHECKPOINT
from twin.errors import TwinError
from twin.logs import read_flight, write_flight
from twin.residuals.aligned import align_flight
from twin.vehicle_file import load_vehicle
from uavtwin.cli import main
from uavtwin.compensators.evaluation import Evaluation
from uavtwin.demo.flights import fly
from uavtwin.force.open_loop import driving_inputs

COPTER = load_vehicle("copter_default")
PLANT = replace(
    COPTER,
    drag_linear_n_s_m=COPTER.drag_linear_n_s_m + 0.5 * COPTER.mass_kg * np.array([1.0, 1.0, 0.0]),
)
PLACES = {
    "one": (2.0, 1.0, -1.0),
    "two": (1.0, -2.0, -1.2),
    "three": (2.0, -1.0, -1.0),
    "four": (-2.0, 1.5, -1.2),
}


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Four flights of a vehicle with more drag than its file says."""
    folder = tmp_path_factory.mktemp("flights")
    paths = {}
    for seed, (name, place) in enumerate(PLACES.items(), start=1):
        legs = (
            ("ground", 0.5, (0.0, 0.0, 0.0)),
            ("takeoff", 2.5, (0.0, 0.0, -1.0)),
            ("forward", 2.5, place),
            ("hover", 1.5, place),
        )
        paths[name] = folder / f"{name}.parquet"
        write_flight(fly(COPTER, PLANT, seed, name, legs), paths[name])
    return paths


def _run(*arguments: object) -> None:
    main.app([str(a) for a in arguments], standalone_mode=False)


def _train(logs: dict[str, Path], out: Path, *more: object) -> None:
    _run(
        "train",
        logs["one"],
        logs["two"],
        "--vehicle",
        "copter_default",
        "--rate",
        50,
        "--epochs",
        2,
        "--out",
        out,
        *more,
    )


@pytest.fixture(scope="module")
def model(logs: dict[str, Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A model of two epochs."""
    folder = tmp_path_factory.mktemp("trained") / "model"
    _train(logs, folder)
    return folder


@pytest.mark.slow
def test_training_leaves_a_model_with_its_page(model: Path) -> None:
    names = {p.name for p in model.iterdir()}
    assert len({stat.filemode(p.stat().st_mode) for p in model.iterdir()}) == 1  # as the umask says
    assert names >= {
        "README.md",
        "report.html",
        "model.onnx",
        "weights.safetensors",
        "model.json",
        "learning_curve.json",
        "vehicle.toml",
        "training.parquet",
        "run.json",
    }
    assert CHECKPOINT not in names
    page = (model / "report.html").read_text("utf-8")
    assert "track, 1 samples (20 ms) ahead" in page
    assert not re.search(r'<(script|link|img)[^>]+(src|href)="http', page)
    run = json.loads((model / "run.json").read_text("utf-8"))
    assert run["options"]["epochs"] == 2 and len(run["inputs"]) == 2


@pytest.mark.slow
def test_evaluation_scores_the_model_beside_baselines(
    model: Path, logs: dict[str, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    explained = tmp_path / "explained.toml"
    explained.write_text((model / "vehicle.toml").read_text("utf-8"), "utf-8")
    _run(
        "evaluate",
        model,
        logs["three"],
        "--explained",
        explained,
        "--out",
        tmp_path / "e",
        "--json",
    )
    printed = json.loads(capsys.readouterr().out)
    assert printed == json.loads((tmp_path / "e" / "evaluation.json").read_text("utf-8"))
    assert (
        printed["runs"] == "fmu" and printed["protocol"] == "track" and printed["horizon_s"] == 0.02
    )
    models = {row["model"] for row in printed["groups"]}
    assert {"none", "mean", "last", "linear AR(8)", "linear part alone", "model"} <= models
    groups = {row["group"] for row in printed["groups"]}
    assert groups == {"gyro", "acc", "pos", "vel"}  # these flights have no magnetometer
    page = (tmp_path / "e" / "report.html").read_text("utf-8")
    figures = str(figures_of(page))
    assert "explained twin" in figures and "corrected twin" in figures
    assert len(page) < 1.5e6
    (result,) = yaml.safe_load((tmp_path / "e" / "README.md").read_text("utf-8").split("---\n")[1])[
        "model-index"
    ][0]["results"]
    own = [g for g in printed["groups"] if g["model"] == "model"]
    assert [m["value"] for m in result["metrics"]] == [g["rmse"] for g in own]
    assert result["dataset"]["args"]["sha256"] == [read_flight(logs["three"]).fingerprint]
    series = pd.read_parquet(tmp_path / "e" / "series" / "three.parquet")
    sides = {c.rpartition(".")[0] for c in series.columns[1:]}
    assert sides == {
        *("measured", "twin", "explained", "corrected", "spread", "model"),
        *("residual", "residual_explained", "residual_corrected"),
    }
    left = {(r["channel"], r["model"]): r for r in printed["channels"] if r["phase"] == "all"}
    for channel in ("acc_x", "gyro_z", "vel_y"):
        told = series[f"residual_corrected.{channel}"].dropna()
        row = left[channel, "model"]
        assert len(told) == row["n"]
        assert np.sqrt(np.mean(told**2)) == pytest.approx(row["rmse"], rel=1e-9)
        no_model = np.sqrt(np.mean(series[f"residual.{channel}"].dropna() ** 2))
        assert no_model == pytest.approx(left[channel, "none"]["rmse"], rel=1e-9)


@needs_browser
@pytest.mark.slow
def test_pages_are_fine_to_look_at(model: Path, logs: dict[str, Path], tmp_path: Path) -> None:
    _run("evaluate", model, logs["three"], "--out", tmp_path / "e")
    with browser(tmp_path) as opened:
        for name, folder in (("training", model), ("evaluation", tmp_path / "e")):
            for view in (VIEWS[0], VIEWS[3]):
                picture = pictures(tmp_path) / f"{name}_{view}.png"
                assert faults(opened, folder / "report.html", view, picture) == [], (name, view)
                assert view.width < 1300 or tables_cut(opened) == [], (name, view)


@pytest.mark.slow
def test_a_family_in_closed_form_goes_through_the_same_verbs(
    logs: dict[str, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """No network: no curve, no alarm; a page without them, figures as for any other."""
    flights = [logs["one"], logs["two"], "--vehicle", "copter_default", "--rate", 50]
    out = tmp_path / "model"
    _run("train", *flights, "--preset", "linear", "--protocol", "free", "--out", out)
    said = " ".join(capsys.readouterr().out.split())
    assert "in the exported FMU" in said and (out / "model.onnx").is_file()
    assert json.loads((out / "run.json").read_text("utf-8"))["options"]["epochs"] is None
    page = (out / "report.html").read_text("utf-8")
    assert "Learning curve" not in page and "Validation time" not in page
    _run("evaluate", out, logs["three"], "--out", tmp_path / "e", "--json")
    printed = json.loads(capsys.readouterr().out)
    assert printed["anomaly"] == [
        {"flight": "three", "share_above_1": None, "largest": None, "at_s": None}
    ]
    assert "Anomaly score" not in (tmp_path / "e" / "report.html").read_text("utf-8")


@pytest.mark.slow
def test_a_model_that_repeats_what_it_sees(
    logs: dict[str, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Under the protocol `reconstruct` the baseline that holds the measurement leaves rounding."""
    flights = [logs["one"], logs["two"], "--vehicle", "copter_default", "--rate", 50]
    out = tmp_path / "model"
    _run("train", *flights, "--epochs", 1, "--protocol", "reconstruct", "--out", out)
    capsys.readouterr()
    _run("evaluate", out, logs["three"], "--out", tmp_path / "e", "--json")
    printed = json.loads(capsys.readouterr().out)
    assert printed["claim"].startswith("reconstruct: the model sees the measurement it repeats")
    assert min(r["rmse"] for r in printed["groups"] if r["model"] != "model") < 1e-15
    assert "no model can beat it" in (tmp_path / "e" / "report.html").read_text("utf-8")


@pytest.mark.parametrize(
    ("own", "baselines", "text"),
    [
        (
            1.0,
            (2.0, 4.0),
            "track, 1 samples (10 ms) ahead: better than the best trivial baseline "
            "for acc by 50 %.",
        ),
        (3.0, (2.0, 4.0), "worse for acc by 50 %."),
        (2.0, (2.0, 4.0), "as good as the best trivial baseline everywhere."),
        (1.0, (0.0, 4.0), "worse for acc (baseline exact)."),
        (0.0, (0.0, 4.0), "as good as the best trivial baseline everywhere."),
        (0.0, (2.0, 4.0), "for acc by 100 %."),
        (1.0, (np.nan, np.nan), "as good as the best trivial baseline everywhere."),
    ],
)
def test_the_claim_of_an_evaluation(
    own: float, baselines: tuple[float, ...], text: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Shares of a baseline, one that leaves exactly nothing among them."""
    names = ("model", "hold", "mean")
    rows = [
        {"group": "acc", "model": m, "rmse": v}
        for m, v in zip(names, (own, *baselines), strict=True)
    ]
    monkeypatch.setattr("uavtwin.compensators.evaluation.by_group", lambda _: pd.DataFrame(rows))
    info = SimpleNamespace(protocol="track", horizon=1, rate_hz=100.0)
    model = cast(TrainedModel, SimpleNamespace(info=info))
    found = Evaluation(model, pd.DataFrame(), (), None, (), "python")
    assert found.claim.endswith(text)


@pytest.mark.slow
def test_a_flight_of_the_training_is_refused(
    model: Path, logs: dict[str, Path], tmp_path: Path
) -> None:
    renamed = tmp_path / "another.parquet"
    renamed.write_bytes(logs["one"].read_bytes())
    with pytest.raises(TwinError, match=r"another.parquet: .* was trained on this flight, named"):
        _run("evaluate", model, renamed, "--out", tmp_path / "e")
    assert not (tmp_path / "e").exists()


@pytest.mark.slow
def test_mistakes_are_found_before_the_work(logs: dict[str, Path], tmp_path: Path) -> None:
    with pytest.raises(TwinError, match=r"no preset 'bset'; there are .*paper"):
        _train(logs, tmp_path / "m", "--preset", "bset")
    with pytest.raises(TwinError, match="preset linear: not under protocol reconstruct"):
        _train(logs, tmp_path / "m", "--preset", "linear", "--protocol", "reconstruct")
    with pytest.raises(TwinError, match="preset linear is in closed form and has no epochs"):
        _train(logs, tmp_path / "m", "--preset", "linear")
    if not torch.cuda.is_available():
        with pytest.raises(
            TwinError, match=r"device cuda: torch .* finds no GPU; train on the pro"
        ):
            _train(logs, tmp_path / "m", "--device", "cuda")
    with pytest.raises(TwinError, match=r"rate 30 Hz: needs 1000 Hz over a whole number"):
        _train(logs, tmp_path / "m", "--rate", 30)
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "precious.txt").write_text("mine", "utf-8")
    with pytest.raises(TwinError, match="exists and is not empty"):
        _train(logs, tmp_path / "full")
    with pytest.raises(TwinError, match=r"no model\.json; a model is what `uavtwin train`"):
        _run("evaluate", tmp_path / "full", logs["three"], "--out", tmp_path / "e")


@pytest.fixture(scope="module")
def free(logs: dict[str, Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A model of the sensors of a twin that follows or flies by itself."""
    folder = tmp_path_factory.mktemp("free") / "model"
    _train(logs, folder, "--protocol", "free", logs["four"])
    return folder


@pytest.mark.slow
def test_training_says_what_the_exported_twin_does(free: Path, logs: dict[str, Path]) -> None:
    """Of flights left out; a channel that is off has no correction, and the claim names it."""
    content = json.loads((free / "in_use.json").read_text("utf-8"))
    assert content["taught"] == "left out" and content["flights"] == ["one", "two", "four"]
    page = (free / "report.html").read_text("utf-8")
    assert "In the exported FMU, on flights left out" in page
    model = load(free)
    correction = model.run(residual_flight(read_flight(logs["one"]), COPTER, 50.0, 0.0)).correction
    for c, channel in enumerate(CHANNELS):
        assert channel not in content["shut"] or not correction[:, c].any()
    on = [c for c in content["channels"] if c["channel"] not in content["shut"]]
    assert {"acc_x", "vel_x"} <= {c["channel"] for c in on}
    assert all(c["corrected"] < c["uncorrected"] for c in on if c["mode"] == "alone")


@pytest.mark.slow
def test_a_twin_is_corrected_in_use(
    free: Path, logs: dict[str, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The shipped FMU on a flight of its own, held against FMPy, which follows throughout."""
    capsys.readouterr()
    _run("evaluate", free, logs["three"], "--out", tmp_path / "e", "--json")
    printed = json.loads(capsys.readouterr().out)
    in_use = printed["in_use"]
    assert in_use["taught"] == "other" and in_use["inside"] >= 0.95
    assert printed["claim"].startswith("free: in the exported FMU, on other flights: following, ")
    rows = {(c["channel"], c["mode"]): c for c in in_use["channels"]}
    assert rows["acc_x", "following"]["corrected"] < 0.8 * rows["acc_x", "following"]["uncorrected"]
    out = tmp_path / "fmus"
    _run("export", "corrected-twin", "--drive", "commands", "--model", free, "--out", out)
    flight = read_flight(logs["three"])
    aligned = align_flight(flight, COPTER)
    every = np.arange(1, len(aligned.states))
    shown = ["imu.acc_x", "compensator.corrected.acc_x", "compensator.correction.acc_x"]
    run = fmpy.simulate_fmu(
        str(out / "corrected_twin.fmu"),
        stop_time=1e-3 * every[-1],
        output_interval=1e-3,
        input=driving_inputs(flight, COPTER, aligned, every, compensated=True),
        output=["compensator.inside", *shown],
    )
    own, better, correction = (run[name] for name in shown)
    np.testing.assert_allclose(better, own + correction, atol=1e-12)  # of one instant
    t_s, acc = flight.signal(["acc_x"])
    k = np.floor((t_s - aligned.inputs.t_s[0]) / 1e-3 + 1e-6).astype(int)
    settled = (k > 2500) & (k < len(own))
    off = [np.sqrt(np.mean((y[k[settled]] - acc[settled, 0]) ** 2)) for y in (own, better)]
    assert off[1] < 0.8 * off[0]


@pytest.mark.slow
def test_a_compensator_of_8_bits_is_smaller(free: Path, tmp_path: Path) -> None:
    sizes: list[int] = []
    for options in ((), ("--int8",)):
        out = tmp_path / f"fmus{len(sizes)}"
        _run("export", "compensator", "--model", free, *options, "--out", out)
        sizes.append((out / "compensator.fmu").stat().st_size)
        run = json.loads((out / "run.json").read_text())
        read = [i["name"] for i in run["inputs"]]
        assert read == ["vehicle.toml", "model_int8.onnx" if options else "model.onnx"]
    assert sizes[1] < 0.8 * sizes[0]


@pytest.mark.slow
def test_a_twin_that_flies_a_mission_is_inside_and_corrected(free: Path, tmp_path: Path) -> None:
    out = tmp_path / "fmus"
    _run("export", "corrected-twin", "--mission", "takeoff", "--model", free, "--out", out)
    run = fmpy.simulate_fmu(
        str(out / "corrected_twin.fmu"),
        stop_time=8.0,
        output_interval=0.02,
        output=["compensator.inside", "compensator.correction.acc_x", "airframe.pos_z"],
    )
    flying = run["airframe.pos_z"] < -0.5
    assert flying.sum() > 100
    assert np.mean(run["compensator.inside"][flying]) > 0.5
    assert np.abs(run["compensator.correction.acc_x"][flying]).max() > 0


@pytest.mark.slow
def test_the_same_seed_gives_the_same_bytes(
    model: Path, logs: dict[str, Path], tmp_path: Path
) -> None:
    _train(logs, tmp_path / "again")
    for path in sorted(model.iterdir()):
        assert (tmp_path / "again" / path.name).read_bytes() == path.read_bytes(), path.name


@pytest.mark.parametrize(
    "verb", [("evaluate", "model", "log.ulg"), ("train", "log.ulg", "--vehicle", "x.toml")]
)
def test_a_machine_without_torch_says_what_to_install(
    verb: tuple[str, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    import sys

    monkeypatch.setitem(sys.modules, "torch", None)
    with pytest.raises(TwinError, match=r"need it: pip install .*'torch>="):
        _run(*verb)
