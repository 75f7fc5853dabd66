"""The gap report opens offline, says the claim first and is the same file every time."""

import re
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import plotly.graph_objects as go
import pytest

from twin.effects import EFFECTS
from twin.explain.inference.estimate import Estimate
from twin.explain.model.numbers import numbers_of
from twin.residuals.gap import Channel, FlightGap, rank, summaries
from twin.vehicle_file import load_vehicle
from uavtwin.gaps import claim
from uavtwin.headline import leading, sure_shares
from uavtwin.report.drawing import Budget, unpacked
from uavtwin.report.gap import channel_figures, gap_page
from uavtwin.wording import describe

HOSTILE = "</script><script>alert('x')</script><b>&"


def flight(name: str = "real_2", n: int = 2000) -> FlightGap:
    """The twin lacks three quarters of a second of vertical push in the takeoff."""
    t_s = np.arange(n) / 200.0
    phase = np.where(t_s < 4.0, "takeoff", "hover").astype(np.str_)
    measured = -9.81 + 0.5 * np.sin(2 * np.pi * 0.4 * t_s)
    lacking = np.where(t_s < 4.0, np.sin(np.pi * t_s / 4.0), 0.0)
    acc = Channel("acc_z", "m/s2", 0.0, t_s, measured, measured - lacking, phase)
    every = slice(100, None, 100)
    position = Channel("pos_x", "m", 0.5, t_s[every], t_s[every], t_s[every] + 0.01, phase[every])
    other = replace(acc, name="acc_x", simulated=measured - 0.01)
    spans = (("takeoff", 0.0, 4.0), ("hover", 4.0, n / 200.0))
    return FlightGap(name, "feisi_x150", (other, acc, position), spans, ("beware",), {"rate": "1"})


class _Loads(HTMLParser):
    """Addresses a browser would fetch, scripts, identifiers and the text of the page."""

    def __init__(self) -> None:
        super().__init__()
        self.fetched: list[str] = []
        self.scripts = 0
        self.ids: list[str] = []
        self.heading = ""
        self._in_heading = False

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        values = dict(attrs)
        if tag in {"script", "img", "iframe", "source", "video", "link", "object", "embed"}:
            address = values.get("src") or values.get("href") or values.get("data")
            if address and not address.startswith("data:"):
                self.fetched.append(address)
        self.scripts += tag == "script"
        self._in_heading = tag == "h1"
        if values.get("id"):
            self.ids.append(str(values["id"]))

    def handle_data(self, data: str) -> None:
        if self._in_heading:
            self.heading += data

    def handle_endtag(self, tag: str) -> None:
        self._in_heading = False


def written(*gaps: FlightGap) -> tuple[str, _Loads]:
    text = gap_page(gaps)
    page = _Loads()
    page.feed(text)
    return text, page


@pytest.mark.slow
def test_report_opens_offline_and_embeds_plotly_once() -> None:
    text, page = written(flight(), flight("real_3"))
    assert page.fetched == []
    assert "@import" not in text.split("</style>")[0]
    assert text.count('id="plotly"') == 1
    assert "Copyright (c)" in text, "the licence of plotly.js goes along"
    assert len(page.ids) == len(set(page.ids))
    assert "flight1-acc-0ms" in page.ids
    assert len(text) < 1.5e6


def test_no_button_uploads_the_flight() -> None:
    """plotly.js 4 offers "send chart to cloud" unless its own buttons are off."""
    text, _ = written(flight())
    page_script = text[text.rindex("<script>") :]
    assert re.findall(r"displayModeBar: (\w+)", page_script) == ["false"]
    assert re.findall(r'button\("(\w+)"', page_script) == ["reset", "PNG", "SVG", "CSV"]


def test_claim_comes_first_and_names_channel_phase_and_size() -> None:
    _, page = written(flight())
    # rms of half a sine of amplitude 1: 0.707 m/s2; signal 0.5 / sqrt 2
    assert page.heading == (
        "Twin and flight disagree most in acc_z (specific force, down axis) during takeoff: "
        "0.707 m/s² rms, 200 % of the signal."
    )


def test_a_channel_that_is_off_by_more_of_its_own_signal_is_named_too() -> None:
    """acc_y hardly moves: a tenth of the gap of acc_z is five times its signal."""
    gap = flight()
    (_, acc, _) = gap.channels
    small = 0.02 * np.sin(2 * np.pi * 0.4 * acc.t_s)
    quiet = replace(acc, name="acc_y", measured=small, simulated=small - 0.1 * acc.residual)
    found = claim(rank(summaries([replace(gap, channels=(acc, quiet))])))
    assert found.startswith("Twin and flight disagree most in acc_z")
    assert "Next to its own small signal, acc_y is further off: 0.0707 m/s² rms, 500 %" in found


def test_a_bar_cut_at_100_percent_says_so_and_the_number_is_not_cut() -> None:
    text, _ = written(flight())
    assert '<i class="cut" style="width:80px"></i>200 %' in text
    assert '<i style="width:80px">' not in text
    assert "cut at 100 %" in text


def test_claim_when_they_agree_and_when_there_is_nothing() -> None:
    gap = flight()
    same = tuple(replace(c, simulated=c.measured - 1e-3) for c in gap.channels)
    assert claim(rank(summaries([replace(gap, channels=same)]))).startswith("Twin and flight agree")
    assert claim([]).startswith("There is nothing to compare")


def test_horizons_are_labelled() -> None:
    text, _ = written(flight())
    assert "teacher-forced" in text
    assert "short horizon, 0.5 s" in text


@pytest.mark.slow
def test_same_flights_give_the_same_bytes() -> None:
    assert gap_page([flight()]) == gap_page([flight()])


@pytest.mark.slow
def test_hostile_names_stay_text() -> None:
    gap = flight(HOSTILE)
    evil = tuple(replace(c, name=c.name + HOSTILE, unit=HOSTILE) for c in gap.channels)
    gap = replace(
        gap,
        vehicle=HOSTILE,
        channels=evil,
        phases=((HOSTILE, 0.0, 10.0),),
        warnings=(HOSTILE,),
        facts={HOSTILE: HOSTILE},
    )
    text, page = written(gap)
    assert "<script>alert" not in text
    plain = written(flight())[1]
    assert page.scripts == plain.scripts


def test_dense_samples_are_a_slow_curve_over_a_band_that_holds_them_all() -> None:
    channel = flight(n=40_010).channels[1]
    figure, _, note = channel_figures([channel], (), "", Budget(200))
    assert "bands: all samples" in note
    band, curve = figure["data"][:2]
    assert (band["fill"], band["name"]) == ("toself", "measured, all samples")
    high, low = np.split(unpacked(band["y"]), 2)
    assert len(high) == len(low) <= 201
    t = unpacked(band["x"])[: len(high)]
    edges = np.searchsorted(channel.t_s, t[:-1] - 2.4e-3)  # held to 1.6 ms
    parts = np.split(channel.measured, edges[1:])
    np.testing.assert_allclose(high[:-2], [p.max() for p in parts[:-1]], atol=1e-4)
    np.testing.assert_allclose(low[::-1][:-2], [p.min() for p in parts[:-1]], atol=1e-4)
    assert len(unpacked(curve["y"])) <= 402


def test_figures_are_ones_that_plotly_knows() -> None:
    """Its own objects refuse an attribute that there is not, and a value that cannot be."""
    gap = flight()
    both = [channel_figures([c] * 2, gap.phases, "t", Budget(300))[:2] for c in gap.channels]
    for figure in (f for two in both for f in two if f is not None):
        checked = go.Figure(figure)
        assert checked.layout.height == figure["layout"]["height"]
        axes = {key for key in figure["layout"] if key.startswith("xaxis")}
        assert {t["xaxis"].replace("x", "xaxis") for t in figure["data"]} == axes
        domains = sorted(figure["layout"][f"y{a[1:]}"]["domain"] for a in axes)
        assert all(0 <= low < high <= 1 for low, high in domains)
        assert checked.layout.yaxis.domain[1] == 1.0


def test_empty_channels_do_not_break_the_page() -> None:
    gap = flight()
    none = np.empty(0)
    empty = Channel("gyro_x", "rad/s", 0.5, none, none, none, np.empty(0, dtype=np.str_))
    nan = replace(gap.channels[0], simulated=np.full(2000, np.nan))
    text, page = written(replace(gap, channels=(empty, nan), facts={}))
    assert page.heading.startswith("There is nothing to compare")
    assert "gyro_x" in text
    written()


@pytest.mark.parametrize("name", ["acc_z", "gyro_rate_x", "pos_y@0.5s", "baro_pa", "odd"])
def test_channel_names_have_words(name: str) -> None:
    assert "_" not in describe(name)


def test_what_is_sure_and_large_leads_before_what_is_large() -> None:
    """A cant that may be half of what is told surely takes a quarter of its share."""
    numbers = {n.full: n for n in numbers_of(EFFECTS.values(), load_vehicle("copter_default"))}
    cant = Estimate(numbers["rotor_cant.yaw_m"], 4e-3, 0.0, (2e-3, 6e-3), 0.1)
    drag = Estimate(numbers["rotor_drag.k_xy_1_s"], 0.4, 0.0, (0.36, 0.44), 0.1)
    flapping = Estimate(numbers["flapping_moment.k_n_s"], 0.8, 0.0, (-0.1, 1.7), 0.5)
    shares = {e: (0.8, "acc_x") for e in ("rotor_cant", "rotor_drag", "flapping_moment", "gust")}
    told = {"rotor_cant": [cant], "rotor_drag": [drag], "flapping_moment": [flapping], "gust": []}
    sure = {e: size for e, (size, _) in sure_shares(shares, told).items()}
    assert sure == pytest.approx(
        {"rotor_cant": 0.2, "rotor_drag": 0.648, "flapping_moment": 0.0, "gust": 0.8}
    )


def test_what_changes_the_flight_leads_the_claim() -> None:
    """Sensors and records lead where nothing else is named; what is not determined follows."""

    def lead(effects: list[str], **shares: float) -> tuple[list[str], str]:
        """All of them determined."""
        return leading(effects, {e: (v, "acc_x") for e, v in shares.items()}, effects)

    assert lead(["baro_bias", "rotor_drag"]) == (["rotor_drag"], " Further: baro bias.")
    assert lead(["baro_bias", "gyro_bias"]) == (["baro_bias", "gyro_bias"], "")
    many = ["clock_offset", "mass_offset", "rotor_drag", "motor_lag", "cog_offset"]
    assert lead(many) == (many[1:4], " Further: cog offset and clock offset.")
    assert lead(["gust", "imu_delay"]) == (["gust"], " Further: imu delay.")
    assert lead(many, cog_offset=0.5, motor_lag=0.2)[0] == ["cog_offset", "motor_lag", many[1]]
    first, later = leading(many, {"cog_offset": (0.5, "gyro_rate_x")}, ["rotor_drag"])
    assert first == ["cog_offset", "rotor_drag"]
    assert later == " Further: mass offset, motor lag and clock offset."
    own = ["clock_offset", "rotor_drag", "baro_bias", "heading_offset"]
    assert leading(own, {}, own, ["clock_offset"])[0] == ["rotor_drag"]
    assert leading(own, {"rotor_drag": (0.5, "acc_x")}, own, ["heading_offset"]) == (
        ["heading_offset", "rotor_drag"],
        " Further: clock offset and baro bias.",
    )
    flown = ["mass_offset", "rotor_drag", "cog_offset", "motor_lag", "accel_bias", "gyro_bias"]
    assert leading(flown, {}, flown, ["accel_bias", "gyro_bias"]) == (
        ["accel_bias", *flown[:3]],  # a sensor takes no place of what acts on the flight
        " Further: gyro bias and motor lag.",
    )
    assert leading(flown[4:], {}, flown, ["gyro_bias"])[0] == ["gyro_bias"]
