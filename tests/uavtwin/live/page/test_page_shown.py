"""The live page as a real browser shows it."""

import math
import socket
import threading
import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from msgspec import structs
from page_rigs.browser import (
    SOME_VIEWS,
    Browser,
    View,
    faults_shown,
    needs_browser,
    pictures,
    tables_cut,
)
from sample_logs import flown_table
from serve_rigs.live_sites import live_site

from twin.logs import Flight
from twin.logs.mavlink.decoder import Sample
from twin.logs.mavlink.frames import dialect
from twin.residuals.gap import Channel
from twin.vehicle_file import load_vehicle
from twin.why.records import Event
from twin.why.watch import Alarm
from uavtwin.live.following import Following, Reading
from uavtwin.live.page.feed import Hub, PageFeed
from uavtwin.live.replay import Replay
from uavtwin.live.session import LiveOptions, LiveSession
from uavtwin.live.status import missing, sentence
from uavtwin.sockets import Address

pytestmark = [pytest.mark.slow, needs_browser]
WIDE = View(1300, False)
HOSTILE = "<img src=x onerror=\"document.title='taken'\"><script>document.title='taken'</script>"
PATIENCE_S = 180.0
INKED = """(c => new Set(new Uint32Array(
    c.getContext("2d").getImageData(0, 0, c.width, c.height).data.buffer)).size > 3)"""
"""Whether more colours than three are on a canvas."""


TWIN = Reading(
    acc_b=(0.0, 0.0, -9.0),
    gyro_b=(0.0, 0.0, 0.0),
    position_n=(1.0, 2.0, -3.0),
    velocity_n=(0.0, 0.0, 0.0),
    q_nb=(1.0, 0.0, 0.0, 0.0),
    omega_b=(0.0, 0.0, 0.0),
)
WEAK = Alarm(
    event=Event(
        cause="rotor_failure",
        rotor=(3,),
        onset_s=12.0,
        probability=0.97,
        text="Rotor 3 loses 20 % of its thrust at 12.00 s",
    ),
    raised_s=14.5,
    known_s=13.5,
)


def feed_of(hub: Hub) -> PageFeed:
    return PageFeed(hub, "copter_default", Following(0.5))


def fly(feed: PageFeed, t_s: float, acc_z: float = -9.8) -> None:
    """One state of an aircraft on a circle, and its twin."""
    east, north = math.sin(t_s), math.cos(t_s)
    feed.sample(Sample("acc", "HIGHRES_IMU", 0, (0.1, -0.2, acc_z)))
    feed.sample(Sample("gyro", "HIGHRES_IMU", 0, (0.0, 0.0, 1.0)))
    feed.sample(Sample("pos", "ODOMETRY", 0, (north, east, -2.0)))
    feed.sample(Sample("vel", "ODOMETRY", 0, (-east, north, 0.0)))
    feed.sample(Sample("q", "ODOMETRY", 0, (math.cos(0.05), math.sin(0.05), 0.0, 0.0)))
    feed.sample(Sample("cmd", "ACTUATOR_OUTPUT_STATUS", 0, (0.5, 0.6, 0.7, 0.8)))
    feed.sample(Sample("vbat_v", "BATTERY_STATUS", 0, (15.25,)))
    feed.state(t_s, replace(TWIN, position_n=(north + 0.1, east, -2.1)), time.monotonic())


@dataclass(frozen=True, slots=True)
class Block:
    channels: tuple[Channel, ...]
    short: tuple[Channel, ...]
    end_s: float


def residuals(until_s: float) -> Block:
    """Half a minute of all channels that the page draws."""
    rng = np.random.default_rng(1)
    t_s = np.arange(0.0, until_s, 0.05)
    phase = np.full(len(t_s), "")

    def channel(name: str, unit: str, horizon_s: float) -> Channel:
        noise = rng.standard_normal(len(t_s))
        return Channel(name, unit, horizon_s, t_s, noise, np.zeros(len(t_s)), phase)

    forced = [channel(f"{n}_{a}", "", 0.0) for n in ("acc", "gyro_rate") for a in "xyz"]
    short = [channel(f"{n}_{a}", "", 0.5) for n in ("vel", "att") for a in "xyz"]
    return Block(tuple(forced), tuple(short), until_s)


def text(there: Browser, selector: str) -> str:
    return str(there.run(f"document.querySelector({selector!r}).textContent"))


def until(there: Browser, expression: str) -> None:
    """Until something is true in the page."""
    end = time.monotonic() + PATIENCE_S
    while not there.run(f"Boolean({expression})"):
        assert time.monotonic() < end, f"never true: {expression}; state {text(there, '#state')}"
        time.sleep(0.05)


def shows(there: Browser, column: str, value: str) -> None:
    until(there, f"document.querySelector('[data-now=\"{column}\"]').textContent === '{value}'")


def test_numbers_change_pause_holds_text_is_text(opened: Browser) -> None:
    hub = Hub()
    feed = feed_of(hub)
    with live_site(hub) as server:
        opened.visit(server.url, WIDE)
        until(opened, "document.querySelector('#state').dataset.state === 'silent'")
        assert text(opened, "#alarms") == "No alarm."
        fly(feed, 1.0, -9.81)
        shows(opened, "acc_z", "-9.81")
        shows(opened, "twin.acc_z", "-9.00")
        shows(opened, "gap.acc_z", "-0.81")
        shows(opened, "roll", "5.7")
        fly(feed, 1.1, -9.5)
        shows(opened, "acc_z", "-9.50")
        opened.run("document.querySelector('#pause').click()")
        for k in range(20):
            fly(feed, 1.2 + 0.1 * k, -8.0 + 0.01 * k)
        feed.said(4, HOSTILE)
        until(opened, "document.querySelector('#state').dataset.state === 'paused'")
        time.sleep(0.5)
        assert text(opened, "[data-now=acc_z]") == "-9.50" and text(opened, "#time") == "1.1"
        opened.run("document.querySelector('#pause').click()")
        shows(opened, "acc_z", "-7.81")
        until(opened, "document.querySelector('#said').textContent.includes('onerror')")
        assert text(opened, "#said p").endswith(f"warning: {HOSTILE}")
        assert opened.run("document.querySelectorAll('#said img, #said script').length") == 0
        assert opened.run("document.title") == "Live: copter_default"
        # what a page of others would do with a hole in it is stopped by the policy as well
        opened.run(
            "document.querySelector('#said').innerHTML = '<img src=x onerror=\"window.bad=1\">'"
        )
        time.sleep(0.2)
        assert opened.run("window.bad === undefined")
        assert [c for c in opened.complaints if "Content Security Policy" not in c] == []
        assert {r for r in opened.requests if not r.startswith(server.url)} == set()


def test_alarms_are_told_in_words_and_end(opened: Browser) -> None:
    hub = Hub()
    feed = feed_of(hub)
    fly(feed, 15.0)
    with live_site(hub) as server:
        opened.visit(server.url, WIDE)
        feed.alarm(WEAK, 1)
        until(opened, "document.querySelector('#alarms .alarm') !== null")
        assert (
            text(opened, "#alarms")
            == f"{sentence(WEAK)}; raised at 14.5 s, 1.0 s after it could be known."
        )
        feed.alarm(structs.replace(WEAK, closed_s=20.0), 1)
        until(opened, "document.querySelector('#alarms .over') !== null")
        over = sentence(structs.replace(WEAK, closed_s=20.0))
        assert "over since 20.0 s" in over
        assert (
            text(opened, "#alarms") == f"{over}; raised at 14.5 s, 1.0 s after it could be known."
        )
        opened.visit(server.url, WIDE)  # one who comes later
        until(opened, "document.querySelector('#alarms .over') !== null")
        assert opened.complaints == []


def test_it_comes_back_after_a_restart(opened: Browser) -> None:
    hub = Hub()
    fly(feed_of(hub), 1.0, -9.81)
    server = live_site(hub)
    port = server.port
    try:
        opened.visit(server.url, WIDE)
        shows(opened, "acc_z", "-9.81")
    finally:
        server.close()
    until(opened, "document.querySelector('#state').dataset.state === 'lost'")
    assert text(opened, "#state").startswith("disconnected; next try in ")
    assert text(opened, "[data-now=acc_z]") == "-9.81"
    hub = Hub()
    with live_site(hub, port=port):
        feed = feed_of(hub)
        until(opened, "document.querySelector('#state').dataset.state !== 'lost'")
        fly(feed, 2.0, -7.25)
        shows(opened, "acc_z", "-7.25")


def test_a_paused_page_keeps_what_it_shows_when_the_connection_is_lost(opened: Browser) -> None:
    hub = Hub()
    fly(feed_of(hub), 1.0, -9.81)
    server = live_site(hub)
    try:
        opened.visit(server.url, WIDE)
        shows(opened, "acc_z", "-9.81")
        opened.run("document.querySelector('#pause').click()")
    finally:
        server.close()
    state = "document.querySelector('#state').dataset.state"
    until(opened, f"{state} === 'lost'")
    hub = Hub()
    fly(feed_of(hub), 2.0, -7.25)
    with live_site(hub, port=server.port):
        until(opened, f"{state} === 'paused'")
        opened.run("document.querySelector('#measured-acc_x').scrollIntoView()")
        drawn = "document.querySelector('#measured-acc_x').data[0].x"
        until(opened, f"{drawn} && {drawn}.length === 1 && {drawn}[0] === 1")
        assert text(opened, "[data-now=acc_z]") == "-9.81"
        opened.run("document.querySelector('#pause').click()")
        shows(opened, "acc_z", "-7.25")


@pytest.mark.parametrize("view", SOME_VIEWS, ids=str)
def test_it_looks_well(opened: Browser, tmp_path: Path, view: View) -> None:
    """Nothing overlaps or is cut, all is drawn, narrow and wide, light and dark."""
    hub = Hub()
    feed = feed_of(hub)
    for k in range(320):
        fly(feed, 0.1 * k)
    feed.block(residuals(30.0))  # type: ignore[arg-type]
    feed.alarm(WEAK, 1)
    with live_site(hub) as server:
        opened.visit(server.url, view)
        until(opened, "document.querySelector('#alarms .alarm') !== null && window.drawAll")
        opened.run("window.drawAll()")
        canvas = "document.querySelector('#measured-acc_x').parentNode.querySelector('canvas')"
        until(opened, f"{canvas} && {INKED}({canvas})")  # while it goes on
        opened.run("document.querySelector('#pause').click()")
        for figure in opened.run("window.liveFigures.ids()"):  # each is filled when it is seen
            opened.run(f"document.getElementById('{figure}').scrollIntoView()")
            curves = "svg .scatterlayer .js-line, svg .track:not([d=''])"
            until(opened, f"document.querySelector('#{figure}').querySelector({curves!r}) !== null")
        band = "document.querySelector('#residuals-imu .shapelayer path') !== null"
        until(opened, band)
        assert faults_shown(opened) == []
        assert tables_cut(opened) == []
        if view == WIDE:
            opened.run("window.scrollTo(0, 0)")
        opened.picture(pictures(tmp_path) / f"live-{view}.png", 6000)


def test_a_real_flight_over_mavlink_is_seen(opened: Browser) -> None:
    """The session hands the page what comes over the socket, words of the aircraft among it."""
    vehicle = load_vehicle("copter_default")
    hub, stop, flown = Hub(), threading.Event(), flown_table().iloc[:800]
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as any_port:
        any_port.bind(("127.0.0.1", 0))
        listen = Address("127.0.0.1", int(any_port.getsockname()[1]))
    feed = PageFeed(hub, vehicle.name, Following(0.5))
    with live_site(hub) as server:
        opened.visit(server.url, WIDE)
        session = LiveSession(vehicle, LiveOptions(listen), page=feed)
        thread = threading.Thread(target=lambda: session.run(stop.is_set, feed.known))
        thread.start()
        aircraft = Replay(listen)
        try:
            aircraft.play(Flight("flown", flown))
            words = dialect.MAVLink_statustext_message(4, b"<b>check</b> mag #1")
            aircraft._send(words, None)
            aircraft._deliver()
            until(opened, "Number(document.querySelector('#until').textContent) > 2")
            until(
                opened, "document.querySelector('[data-now=\"twin.acc_z\"]').textContent.length > 3"
            )
            until(opened, "document.querySelector('#said').textContent.includes('check')")
            until(opened, "document.querySelector('#health').textContent.includes('system 1 at')")
            seen = {n: float(text(opened, f"[data-now={n}]")) for n in ("acc_z", "pos_z", "vel_x")}
        finally:
            aircraft.close()
            stop.set()
            thread.join()
    assert text(opened, "#said p").endswith("warning: <b>check</b> mag #1")
    assert text(opened, "#missing") == missing(session.known().sources)["vbat_v"]
    for name, value in seen.items():  # the newest that was told is one of the last
        answered = flown[name].to_numpy()[-30:]
        assert np.nanmin(answered) - 0.01 <= value <= np.nanmax(answered) + 0.01, name
    assert opened.complaints == []
