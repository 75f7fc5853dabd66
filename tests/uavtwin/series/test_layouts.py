"""Layouts of PlotJuggler and Foxglove: every curve and panel is of the MCAP next to them."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pandas as pd
import pytest
from cli_rig import run
from lxml import etree
from sample_logs import flown_table
from series_rigs.mcap_rig import read_mcap

from twin.logs import Flight
from uavtwin.series.layouts import foxglove, plotjuggler, plots_of

FLIGHT = Flight("flown", flown_table().iloc[:200])
FOXGLOVE: dict[str, set[str]] = {
    "3D": {"scene", "transforms", "layers", "topics", "cameraState", "followTf", "fixedFrame"},
    "map": {"disabledTopics", "followTopic", "layer", "topicColors", "zoomLevel", "topicConfig"},
    "Plot": {
        *("paths", "showLegend", "legendDisplay", "showXAxisLabels", "showYAxisLabels", "isSynced"),
        *("xAxisVal", "timeRange", "foxglovePanelTitle"),
    },
    "camera": {
        *("distance", "perspective", "phi", "target", "targetOffset", "targetOrientation"),
        *("thetaOffset", "fovy", "near", "far", "logDepth"),
    },
    "layer": {"visible", "frameLocked", "label", "order", "layerId", "instanceId"},
    "topic": {"visible", "type", "axisScale", "color"},
    "path": {"value", "enabled", "timestampMethod", "label", "color", "showLine", "lineSize"},
}
"""Settings that the program knows, by panel and part of one: foxglove-sdk 0.30.3, foxglove.layouts;
the title of a panel is that of exported files."""
PLOTJUGGLER = {
    "root": set(),
    "tabbed_widget": {"name", "parent"},
    "Tab": {"containers", "tab_name"},
    "Container": set(),
    "DockSplitter": {"orientation", "count", "sizes"},
    "DockArea": {"name"},
    "plot": {"mode", "flip_x", "flip_y", "line_width", "style"},
    "limitY": {"min", "max"},
    "curve": {"name", "color"},
    "currentTabIndex": {"index"},
    "use_relative_time_offset": {"enabled"},
}
"""Attributes that the program reads, by element: plot_docker.cpp, plotwidget.cpp."""


def panels_of(layout: Any) -> list[str]:
    """Names of the panels in the tree of a layout."""
    if isinstance(layout, str):
        return [layout]
    assert layout["direction"] in ("row", "column") and 0 < layout["splitPercentage"] < 100
    return panels_of(layout["first"]) + panels_of(layout["second"])


@pytest.mark.slow
def test_layouts_lie_next_to_the_mcap_and_name_what_it_has(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    table, out = tmp_path / "flown.parquet", tmp_path / "out.mcap"
    FLIGHT.table.to_parquet(table)
    code, said, _ = run(capsys, "convert", table, "--out", out)
    assert code == 0 and "out.foxglove.json, out.plotjuggler.xml" in said
    read = read_mcap(out)
    fields = {(t, f) for t, s in read.schemas.items() for f in s.get("properties", ())}
    layout = json.loads((tmp_path / "out.foxglove.json").read_text())
    panels = layout["configById"]
    assert sorted(panels_of(layout["layout"])) == sorted(panels)
    assert "3D!uavtwin" in panels and "map!uavtwin" not in panels, "it has no origin"
    paths = [p["value"] for panel in panels.values() for p in panel.get("paths", ())]
    assert {(t, f) for p in paths for t, _, f in [p.partition(".")]} <= fields
    root = etree.fromstring((tmp_path / "out.plotjuggler.xml").read_bytes())
    curves = [c.get("name") for c in root.iter("curve")]
    assert [c.rpartition("/")[::2] for c in curves] == [tuple(p.split(".")) for p in paths]
    assert {"/imu/acc_x", "/motors/cmd_4", "/position/pos_z"} <= set(curves)
    (splitter,) = root.iter("DockSplitter")
    count = int(splitter.get("count"))
    assert count == len(splitter) == len(splitter.get("sizes").split(";")) == len(panels) - 1
    (tmp_path / "new.foxglove.json").write_text("mine")
    again, _, err = run(capsys, "convert", table, "--out", tmp_path / "new.mcap")
    assert again == 2 and "new.foxglove.json" in err and "--force" in err


def test_a_flight_of_few_signals_has_a_layout() -> None:
    few = replace(FLIGHT, table=pd.DataFrame(FLIGHT.table[["time", "gyro_x", "phase"]]))
    plots = plots_of(few)
    assert len(plots) == 1
    assert json.loads(foxglove(plots, False, False))["layout"] == "Plot!uavtwin0"
    assert 'count="1"' in plotjuggler(plots)


def test_layouts_hold_what_the_programs_read() -> None:
    plots = plots_of(FLIGHT)
    for name, panel in json.loads(foxglove(plots, True, True))["configById"].items():
        assert set(panel) <= FOXGLOVE[name.partition("!")[0]], name
        assert set(panel.get("cameraState", ())) <= FOXGLOVE["camera"]
        for part, kind in (("layers", "layer"), ("topics", "topic")):
            assert all(set(v) <= FOXGLOVE[kind] for v in panel.get(part, {}).values())
        assert all(set(path) <= FOXGLOVE["path"] for path in panel.get("paths", ()))
        assert panel.get("legendDisplay", "top") in ("floating", "top", "left")
    root = etree.fromstring(plotjuggler(plots).encode())
    for element in root.iter():
        assert set(element.attrib) <= PLOTJUGGLER[element.tag], element.tag
    (splitter,) = root.iter("DockSplitter")
    assert splitter.get("orientation") in "|-"
    assert sum(map(float, splitter.get("sizes").split(";"))) == pytest.approx(1.0, abs=1e-5)
    assert {p.get("style") for p in root.iter("plot")} == {"Lines"}
    assert {p.get("mode") for p in root.iter("plot")} == {"TimeSeries"}
