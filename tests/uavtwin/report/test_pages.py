"""Pages as people see them: wide and narrow, light and dark, in a browser that is watched."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from page_rigs.browser import (
    SOME_VIEWS,
    VIEWS,
    Browser,
    View,
    faults,
    needs_browser,
    pictures,
)
from page_rigs.circle import gap_of, recorded

from cosim.recording import Recording
from twin.logs.columns import POS, QUAT
from uavtwin.gaps import GapResult
from uavtwin.report.drawing import PAGE_BYTES
from uavtwin.run import Run

pytestmark = needs_browser


@pytest.fixture(scope="module")
def gap_page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("gap") / "gap.html"
    flight = recorded()
    gap = gap_of(flight)
    return GapResult((gap, replace(gap, flight="again")), (flight, flight)).report(path)


@pytest.mark.slow
@pytest.mark.parametrize("view", SOME_VIEWS, ids=str)
def test_gap_page_is_fine_to_look_at(
    opened: Browser, gap_page: Path, view: View, tmp_path: Path
) -> None:
    assert faults(opened, gap_page, view, pictures(tmp_path) / f"gap_{view}.png") == []
    assert gap_page.stat().st_size < PAGE_BYTES


@pytest.mark.parametrize("view", SOME_VIEWS, ids=str)
def test_page_of_a_simulation_is_fine_to_look_at(
    opened: Browser, view: View, tmp_path: Path
) -> None:
    flight = recorded()
    names = {f"airframe.{n}": flight.table[n].to_numpy() for n in (*POS, *QUAT)}
    names |= {f"mission.setpoint_{n}": names[f"airframe.{n}"] + 0.1 for n in POS}
    names |= {f"airframe.vel_{a}": np.gradient(names[f"airframe.pos_{a}"]) for a in "xyz"}
    names |= {f"mission.setpoint_vel_{a}": names[f"airframe.vel_{a}"] * 0.9 for a in "xyz"}
    names["mission.phase"] = np.where(flight.time_s < 5, 1.0, 2.0)
    names |= {f"controller.cmd_{i}": flight.table[f"cmd_{i}"].to_numpy() for i in range(1, 5)}
    flown = Recording(tuple(names), flight.time_s, np.column_stack(list(names.values())))
    page = tmp_path / "simulation.html"
    units = {n: "m" for n in names if "pos" in n}
    Run("circle", flown, units, {"wind": "5,0,0"}).report(page)
    assert faults(opened, page, view, pictures(tmp_path) / f"simulation_{view}.png") == []
    assert page.stat().st_size < PAGE_BYTES


def test_zoom_keys_and_numbers_of_a_page(opened: Browser, gap_page: Path) -> None:
    """Zooming one plot over time moves those of its flight and no other; a key hides its curve; the
    CSV holds what is drawn; a formula of a spreadsheet stays text."""
    opened.open(gap_page, VIEWS[0])
    result = opened.run(
        """
(async () => {
  while (!window.drawAll) await new Promise(r => setTimeout(r, 20));
  window.drawAll();
  const at = id => document.getElementById(id)._fullLayout.xaxis.range.map(v => +v.toFixed(3));
  await Plotly.relayout("flight0-acc-0ms", { "xaxis.range": [4, 6] });
  await new Promise(r => setTimeout(r, 50));
  const moved = [at("flight0-acc-0ms"), at("flight0-pos-500ms"), at("flight0-logged")];
  const other = at("flight1-acc-0ms");
  const div = document.getElementById("flight0-pos-500ms");
  const key = [...div.parentNode.querySelectorAll(".key")].find(b => b.textContent === "measured");
  key.click();
  await new Promise(r => setTimeout(r, 50));
  const hidden = div._fullData.filter(t => t.name === "measured").map(t => t.visible);
  let text = "";
  window.URL.createObjectURL = blob => { text = blob.text(); return "data:,"; };
  HTMLAnchorElement.prototype.click = () => {};
  const csv = [...div.parentNode.querySelectorAll("button")].find(b => b.textContent === "CSV");
  csv.click();
  const strip = ["flight0-acc-0ms", "flight0-spectrogram"].map(id => {
    const d = document.getElementById(id);
    const t = d._fullData.filter(t => t.yaxis === "y99");
    const images = d.querySelectorAll("image").length, domain = d._fullLayout.yaxis.domain;
    return [t.length, t[0].x.length, domain[1] < 1, images];
  });
  return { moved, other, hidden, strip, csv: (await text).split("\\r\\n").slice(0, 2) };
})()
"""
    )
    assert result["moved"] == [[4, 6]] * 3
    assert result["other"] != [4, 6]
    (traces, marks, below, images), (_, _, _, pictures_there) = result["strip"]
    assert (traces, below, images, pictures_there) == (1, True, 0, 1)
    assert marks > 40, "armed, disarmed, two failsafes, messages of the flight"
    assert result["hidden"] == [False] * 3
    assert result["csv"][0] == "series,panel,x,y"
    name, panel, x, y = result["csv"][1].split(",")[0:1] + result["csv"][1].rsplit(",", 3)[1:]
    assert (name, float(x)) == ("measured", 0.5)
    assert opened.complaints == []
    assert panel
    assert np.isfinite(float(y))


def test_a_flight_is_hidden_in_all_figures_that_lay_it_over_others(
    opened: Browser, gap_page: Path
) -> None:
    opened.open(gap_page, VIEWS[0])
    result = opened.run(
        """
(async () => {
  while (!window.drawAll) await new Promise(r => setTimeout(r, 20));
  window.drawAll();
  const names = ["over-acc-0ms", "over-pos-500ms", "over-battery"];
  const there = names.map(id => document.getElementById(id));
  const keys = div => [...div.parentNode.querySelectorAll(".key")];
  const key = div => keys(div).find(b => b.textContent === "again");
  key(there[0]).click();
  await new Promise(r => setTimeout(r, 50));
  const hidden = div => div._fullData.filter(t => t.visible === false);
  const gone = there.map(div => hidden(div).map(t => t.name));
  const pressed = there.map(div => key(div).getAttribute("aria-pressed"));
  const own = hidden(document.getElementById("flight1-acc-0ms")).length;
  const last = there.map(div => div.layout.xaxis6 || div.layout.xaxis2);
  return { gone, pressed, own, titles: last.map(a => a.title.text) };
})()
"""
    )
    assert [set(names) for names in result["gone"]] == [{"again"}] * 3
    assert [len(names) for names in result["gone"]] == [6, 6, 2]
    assert result["pressed"] == ["false"] * 3
    assert result["own"] == 0
    assert result["titles"] == ["time from take-off, s"] * 3


@pytest.mark.slow
def test_the_test_of_pages_sees_what_is_wrong(opened: Browser, tmp_path: Path) -> None:
    page = tmp_path / "bad.html"
    page.write_text(
        '<!DOCTYPE html><main><h1 style="width:3000px">wide</h1><h2 style="margin-top:-30px">on it'
        "</h2></main><script>window.drawAll = () => {}; console.error('no')</script>"
        '<img src="https://example.invalid/a.png">',
        "utf-8",
    )
    found = "\n".join(faults(opened, page, VIEWS[1]))
    for fault in ("px wide", "lies on", "on the console", "asks for https://example.invalid"):
        assert fault in found
