"""The paper's tables: scores by hand, a finished training is not done again, every row is there."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import onnx
import onnxruntime
import pytest
import torch
from learning_rigs.compensator_rig import tiny
from places import ROOT

from benchmarks.paper import comparison as paper
from benchmarks.paper import edge, tables
from benchmarks.paper.edge import export_system, untrained_system, usage, usage_figure
from benchmarks.paper.figures import (
    FlightCorrections,
    best_systems,
    by_share,
    comparison,
    error_distributions,
    figures_page,
    improvements,
    removed,
    timelines,
)
from benchmarks.paper.missions import real_missions, simulated_missions
from benchmarks.paper.trainings import (
    METRICS,
    RECORDING,
    Rule,
    Run,
    code_hash,
    drawn_scores,
    paper_flights,
    run_all,
    said_by,
    scores,
    shortened,
)
from learning.data.channels import GROUPS, N_PHASES
from learning.export.streaming import streaming_model
from learning.model.compensator import ModelInfo, untrained_compensator

SMALL = tiny(name="small", clustering="none", epochs=2)


@pytest.fixture(scope="module")
def residual_tables(data_dir: Path) -> Path:
    return data_dir / "rflysimdt" / "paper_residuals"


def test_scores_in_three_systems_of_units(residual_tables: Path) -> None:
    """A correction that is off by a tenth of the unit everywhere."""
    flights = paper_flights(residual_tables)
    away = flights[2]
    spread = np.concatenate([f.residual for f in flights[:2]]).std(axis=0)
    found = scores([away.residual + 0.1 * spread], [away], flights[:2], flights)
    for modality in ("takeoff", "hover"):
        said = found[modality]["standardised"]
        np.testing.assert_allclose([said[m] for m in METRICS], [0.01, 0.1, 0.1, 0.1], rtol=1e-6)
    units = np.ones(15)
    units[GROUPS["mag"]] = 1e-4  # gauss in tesla
    expected = float(np.mean(0.1 * spread / units))
    np.testing.assert_allclose(found["hover"]["physical"]["mae"], expected)


def test_draws_are_scored_by_their_mean_and_each_by_its_distribution(residual_tables: Path) -> None:
    """Two draws, a tenth of the unit above and below what was measured."""
    flights = paper_flights(residual_tables)
    away = flights[2]
    spread = np.concatenate([f.residual for f in flights[:2]]).std(axis=0)
    draws = [[away.residual + sign * 0.1 * spread] for sign in (-1, 1)]
    found = drawn_scores(draws, [away], flights[:2], flights)
    for modality in ("takeoff", "hover"):
        said = found[modality]["standardised"]
        assert said["rmse"] == pytest.approx(0.0, abs=1e-12)
        assert said["wasserstein"] == pytest.approx(0.1)
        assert said["spectral_db"] == pytest.approx(0.0, abs=1e-6)


@pytest.mark.slow
def test_what_draws_stands_in_a_table_of_its_own(residual_tables: Path, tmp_path: Path) -> None:
    """A system that learns to draw apart, one that draws by what it learned, a recording."""
    options = paper.Options(epochs=1, seeds=1, shares=(0.1,))
    wanted = ("wgan", "vqvae", paper.RECORDED)
    runs = [r for r in paper.table2(options) if r.name in wanted]
    assert [(r.preset.name, r.role) for r in runs] == [
        ("vqvae", "reconstruct"),
        ("wgan", "reconstruct"),
        ("wgan", "generate"),
        (RECORDING.name, "generate"),
    ]
    rows = paper.rows_of("II", run_all(residual_tables, tmp_path, runs), "abc")
    assert [r["row"] for r in rows if "scores" in r] == ["vqvae", "wgan"]
    drawn = tables.drawn(rows, 0.1)
    assert [n for n in wanted if f"| {n} |" in drawn] == list(wanted)


def test_less_data_is_the_start_of_each_phase(residual_tables: Path) -> None:
    flight = paper_flights(residual_tables, (1,))[0]
    half = shortened(flight, 0.5)
    assert half.spans == ((0, 429), (858, 858 + 1678))
    assert half.fresh[:429].all() and not half.fresh[429:858].any()


@pytest.mark.slow
def test_a_training_is_done_once(
    residual_tables: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    flights = paper_flights(residual_tables)
    runs = [Run("one", SMALL, share=0.1), Run("same by another name", SMALL, share=0.1)]
    first = run_all(residual_tables, tmp_path, runs)
    assert "1 trainings, 1 to be done" in capsys.readouterr().err
    assert first == run_all(residual_tables, tmp_path, runs)
    assert "1 trainings, 0 to be done" in capsys.readouterr().err
    assert [f["run"]["name"] for f in first] == [r.name for r in runs]
    assert list(tmp_path.glob("models/*")) == []
    said = said_by(runs[0], tmp_path)
    again = scores([said], flights[2:], [shortened(f, 0.1) for f in flights[:2]], flights)
    assert again == first[0]["scores"]


def test_figures_show_what_each_system_said(residual_tables: Path) -> None:
    """The better one first; every figure is there, and nothing is fetched."""
    flights = paper_flights(residual_tables)
    residual = flights[2].residual
    said = {"half": residual / 2, "none": np.zeros_like(residual), "tenth": 0.9 * residual}
    assert list(FlightCorrections.of(flights, said).errors()) == ["tenth", "half", "none"]
    (histograms, *_) = error_distributions(FlightCorrections.of(flights, said)).data
    assert histograms.name == "tenth"
    page = figures_page(comparison(flights, said))
    assert page.count("data-for=") == 5
    assert "Figure 8" in page and "src=" not in page.split("<script>", 1)[0]


@pytest.mark.long
def test_missions_are_drawn_as_they_were_flown(
    residual_tables: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Four missions of two aircraft; what is passed through leaves nothing, nothing leaves all."""
    monkeypatch.setattr("benchmarks.hidden_effects.plants.missions.DURATION_S", 8.0)
    flights = paper_flights(residual_tables)
    residual = flights[2].residual
    real = real_missions(flights, {"all": residual, "half": residual / 2})
    run = Run("all", SMALL)
    missions = {**real, **simulated_missions(tmp_path, [run], 1)}
    again = simulated_missions(tmp_path, [run], 1)
    for kind in ("forward", "tour"):
        np.testing.assert_array_equal(missions[kind].by_system["all"], again[kind].by_system["all"])
        assert np.isfinite(missions[kind].residual).all() and len(missions[kind].t_s) > 300
    assert {k: f.aircraft for k, f in missions.items()} == {
        **dict.fromkeys(("takeoff", "hover"), "real"),
        **dict.fromkeys(("forward", "tour"), "simulated"),
    }
    hover = missions["hover"]
    whole, left = hover.residual / hover.unit, hover.left()
    np.testing.assert_allclose(removed(whole, left["all"]), 100)
    np.testing.assert_allclose(removed(whole, left["half"]), 50)
    figures = [
        timelines(missions, "all"),
        improvements({"all of it": (missions, "all")}),
        best_systems(missions, ["all"]),
    ]
    traces = {name for figure in figures for name in (t.name for t in figure.data)}
    assert {"measured", "simulated", "corrected", "all of it", "residual", "all"} <= traces
    (bars, *_) = (t for t in figures[1].data if t.name == "all of it")
    np.testing.assert_allclose(bars.y, 100)  # of hover, each sensor


@pytest.mark.slow
def test_usage_is_that_of_the_process_that_runs(tmp_path: Path) -> None:
    model = untrained_compensator(ModelInfo(SMALL, "reconstruct", 0, 100.0, 0, (tuple(range(15)),)))
    onnx.save(streaming_model(model), tmp_path / "small.onnx")
    used = usage(tmp_path / "small.onnx", seconds=2.0)
    assert used.t_s[-1] > 2.0 and len(used.t_s) == len(used.processor) == len(used.memory_mb)
    assert 20 < used.memory_mb[-1] < 500
    assert max(used.processor) > 1.5 * used.processor[-1]  # it loads, then mostly waits
    assert [t.name for t in usage_figure({"small": used}).data] == ["small", "small"]


def test_less_data_is_drawn_from_most_to_least() -> None:
    found = [
        {
            "row": name,
            "share": share,
            "scores": {m: {"standardised": {"mse": [1 / share]}} for m in ("takeoff", "hover")},
        }
        for name in ("one", "other")
        for share in (1.0, 0.25, 0.5)
    ]
    drawn = by_share(found).data
    assert [t.name for t in drawn] == ["one", "one", "other", "other"]
    assert list(drawn[0].x) == [25, 50, 100] and list(drawn[0].y) == [4, 2, 1]


@pytest.mark.parametrize("table", paper.TABLES)
def test_every_table_names_its_runs(table: str) -> None:
    runs = paper.TABLES[table](paper.Options(epochs=7, seeds=2))
    assert len(runs) >= 4
    assert {getattr(r.preset, "epochs", 7) for r in runs} == {7}
    assert all(r.test not in r.train for r in runs)


@pytest.mark.slow
def test_every_system_is_written_as_what_it_says(tmp_path: Path) -> None:
    """In onnxruntime as in torch, where nothing is drawn; and what a process says it costs."""
    system = untrained_system("vqvae")
    window = system.preset.window
    file = export_system(system, tmp_path / "vqvae.onnx")
    given, phase = torch.randn(1, window, 15), torch.eye(N_PHASES)[[1] * window][None]
    session = onnxruntime.InferenceSession(file)
    (said,) = session.run(None, {"given": given.numpy(), "phase": phase.numpy()})
    with torch.no_grad():
        np.testing.assert_allclose(said, system.reconstruct(given, phase), atol=1e-5)
    cost = edge.measured("vqvae", system, window, file)
    assert 0 < cost.ms < 10 and cost.memory_mb is not None and 1 < cost.memory_mb < 500
    assert cost.scores()["samples"] == window and cost.scores()["weights"] == cost.numbers


def test_where_a_system_cannot_be_trained_the_table_says_so() -> None:
    score = {m: {"standardised": {"rmse": [0.5, None]}} for m in ("takeoff", "hover")}
    rows = [
        {"table": "needed", "row": n, "role": p, "scores": score}
        for n, p in (("linear", "track"), ("linear", "free"), ("tsgan", "free"))
    ]
    *_, linear, tsgan, _ = tables.needed(rows).split("\n")
    assert linear == "| linear | 0.500 | 0.500 | 0.500 | 0.500 |"
    assert tsgan == "| tsgan | - | - | 0.500 | 0.500 |"


def test_the_pages_are_printed_from_the_scores() -> None:
    command = [sys.executable, str(ROOT / "docs" / "_generate" / "paper.py"), "--check"]
    said = subprocess.run(command, capture_output=True, text=True, check=False)
    assert said.returncode == 0, said.stderr


def test_the_paper_stands_beside_ours_by_modality_and_share() -> None:
    """Numbers read from its Table II by hand: modality 2 is takeoff, 1 hover."""
    rows = paper.read_rows()
    (line,) = (x for x in tables.table2(rows, 0.5).split("\n") if x.startswith("| cvae (n = 1) |"))
    _, theirs, ours, others, _ = line.strip("| ").split(" | ")
    assert theirs == "1.312 / 0.4781 / 0.3737" and others == "0.8746 / 0.3686 / 0.2875"
    assert ours == "0.88 / 0.72 / 0.62"


def test_seeds_of_a_row_are_pooled_and_rows_replaced(tmp_path: Path) -> None:
    found = [
        {
            "run": {"name": "cvae", "role": "reconstruct", "share": 1.0},
            "weights": 3,
            "seconds": 2.0,
            "scores": {"hover": {"standardised": {"mse": mse}}},
        }
        for mse in (1.0, 3.0)
    ]
    (row,) = paper.rows_of("II", found, "abc")
    assert row["n"] == 2 and row["commit"] == "abc"
    assert row["scores"]["hover"]["standardised"]["mse"] == [2.0, pytest.approx(1.41, abs=0.01)]
    file = tmp_path / "scores.jsonl"
    paper.write_rows([row, {**row, "share": 0.5}], file)
    paper.write_rows([{**row, "n": 5}], file)
    assert [(r["share"], r["n"]) for r in paper.read_rows(file)] == [(1.0, 5), (0.5, 2)]


def test_only_code_that_decides_a_run_makes_it_another(monkeypatch: pytest.MonkeyPatch) -> None:
    """What is exported, evaluated or said of the code decides nothing."""
    read, seen = Path.read_text, set[str]()

    def watched(path: Path, *arguments: str) -> str:
        seen.add(path.stem)
        return read(path, *arguments).replace('"""', '"""\n')

    before = {n: Run(n, Rule(n)).key() for n in ("mean", "recording")}
    code_hash.cache_clear()
    monkeypatch.setattr(Path, "read_text", watched)
    assert {n: Run(n, Rule(n)).key() for n in ("mean", "recording")} == before
    code_hash.cache_clear()
    assert "baselines" in seen and not seen & {"evaluation", "in_use", "network"}
