"""The page as a real browser shows it: dropped, read, cancelled, killed, started again."""

import socket
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import psutil
import pytest
from page_rigs.browser import Browser, View, browser, needs_browser, pictures
from serve_rigs.sites import Asked, Process, site, sound_log

from twin.vehicle_file import load_vehicle
from uavtwin.live.following import Following
from uavtwin.live.page.view import LiveView
from uavtwin.serve.store import Store

pytestmark = [pytest.mark.slow, needs_browser]
WIDE, PHONE, DARK = View(1300, False), View(412, False), View(1300, True)
ROWS = "document.querySelectorAll('#rows tr').length"
VERDICTS = "document.querySelectorAll('#rows .verdict').length"
HOSTILE = "<img src=x onerror=document.title=0>.ulg"


@pytest.fixture(scope="module")
def served(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Process]:
    with Process(tmp_path_factory.mktemp("store") / "new") as process:
        yield process


@pytest.fixture(scope="module")
def flight(served: Process, opened: Browser, tmp_path_factory: pytest.TempPathFactory) -> str:
    """Address of the page of a flight that was dropped with a hostile one, and is read."""
    logs = tmp_path_factory.mktemp("logs")
    hostile = logs / HOSTILE
    hostile.write_bytes(b"ULog\x01\x12\x35\x01 no log at all")
    opened.visit(served.address, WIDE)
    opened.drop("#drop", sound_log(logs), hostile)
    opened.wait("document.querySelectorAll('#rows tr').length === 2")
    opened.wait("document.querySelector('.verdict.unreadable')")
    opened.wait(f"{VERDICTS} === 2 && !document.querySelector('#rows .tag')", 90)
    assert opened.complaints == []
    return str(opened.run("[...document.links].find(a => a.text === 'sound.parquet').href"))


@pytest.fixture(scope="module")
def flying(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Asked, LiveView]]:
    """A site with a live flight."""
    live = LiveView(load_vehicle("copter_default"), Following(0.5), True)
    with site(tmp_path_factory.mktemp("live") / "new", live=live.routes) as asked:
        yield asked, live


def test_a_hostile_name_is_text(served: Process, opened: Browser, flight: str) -> None:
    opened.visit(served.address, WIDE)
    assert opened.run("document.title") == "Flights"
    assert opened.run("document.querySelectorAll('#rows img').length") == 0


@pytest.mark.parametrize("view", [WIDE, PHONE, DARK], ids=str)
def test_pages_fit_and_complain_of_nothing(
    served: Process, opened: Browser, flight: str, view: View, tmp_path: Path
) -> None:
    for name, address in {"list": served.address, "flight": flight, "why": f"{flight}/why"}.items():
        opened.visit(address, view)
        opened.wait("document.documentElement.dataset.connected || window.drawAll")
        assert opened.run("document.documentElement.scrollWidth") <= view.width
        dark = opened.run("getComputedStyle(document.body).backgroundColor") == "rgb(20, 23, 27)"
        assert dark == view.dark
        assert opened.complaints == []
        assert [r for r in opened.requests if not r.startswith(served.address)] == []
        opened.picture(pictures(tmp_path) / f"serve-{name}-{view}.png", 2000)


def test_a_link_leads_to_a_moment(opened: Browser, flight: str) -> None:
    opened.visit(flight, WIDE)
    opened.visit(f"{flight}/why#t=7.5", WIDE)
    opened.wait("document.querySelector('.plot svg')")
    look = "document.getElementById('why-line')._fullLayout.xaxis.range.join()"
    assert opened.run(look) == "2.5,12.5"
    opened.run("location.hash = 't=12'")
    opened.wait(f"{look} === '7,17'")
    assert opened.complaints == []


@pytest.mark.parametrize("view", [WIDE, PHONE, DARK], ids=str)
def test_a_live_flight_is_a_page_of_the_same_site(
    flying: tuple[Asked, LiveView], opened: Browser, tmp_path: Path, view: View
) -> None:
    asked, live = flying
    opened.visit(f"{asked.address}/", view)
    opened.wait("document.documentElement.dataset.connected")
    opened.run("[...document.links].find(a => a.text === 'Live').click()")
    opened.wait("document.querySelector('#state')")
    live.feed.said(4, "low battery")
    opened.wait("document.querySelector('#said').innerText.includes('low battery')")
    assert opened.run("document.documentElement.scrollWidth") <= view.width
    assert opened.complaints == []
    opened.picture(pictures(tmp_path) / f"serve-live-{view}.png", 900)
    opened.run("[...document.links].find(a => a.text === 'Flights').click()")
    opened.wait("document.querySelector('#drop')")


def test_two_tabs_show_the_same(served: Process, opened: Browser, flight: str) -> None:
    opened.visit(served.address, WIDE)
    opened.wait("document.documentElement.dataset.connected")
    with opened.tab():
        opened.visit(flight, PHONE)
        opened.run("document.getElementById('words').value = 'second tab'")
        opened.run("document.querySelector('form[action$=tags] button').click()")
        opened.wait("document.getElementById('words').defaultValue === 'second tab'")
    opened.wait("document.querySelector('#rows').innerText.includes('second tab')")
    assert opened.complaints == []


def test_the_keyboard_alone_reaches_everything(
    served: Process, opened: Browser, flight: str
) -> None:
    opened.visit(served.address, WIDE)
    opened.run("document.activeElement.blur()")
    reached = []
    for _ in range(9):
        opened.press("Tab")
        reached.append(opened.run("document.activeElement.id || document.activeElement.outerHTML"))
    assert reached[2:4] == ["files", "q"] and "compare-button" in reached
    opened.run("[...document.links].find(a => a.text === 'sound.parquet').focus()")
    opened.press("Enter")
    opened.wait("document.getElementById('begin-mcap')")
    opened.run("document.getElementById('begin-mcap').focus()")
    opened.press(" ")
    opened.wait("document.getElementById('open-mcap')", 90)


def test_a_job_is_cancelled_killed_with_its_server_and_goes_on_with_the_next(
    served: Process, opened: Browser, flight: str
) -> None:
    opened.visit(flight, WIDE)
    opened.run("document.getElementById('choice').value = 'copter_default'")
    opened.run("document.querySelector('form[action$=vehicle] button').click()")
    opened.wait("document.getElementById('open-gap')", 90)
    opened.run("document.getElementById('begin-explain').click()")
    opened.wait("document.querySelector('#cancel-explain') && document.querySelector('progress')")
    opened.run("document.getElementById('cancel-explain').click()")
    opened.wait("document.body.innerText.includes('Cancelled.')")
    opened.run("document.getElementById('begin-explain').click()")
    opened.wait("document.querySelector('progress')")
    served.kill()
    opened.wait("document.body.innerText.includes('The server does not answer')")
    served.start()
    opened.wait("!document.body.innerText.includes('The server does not answer')")
    opened.wait("document.querySelector('#cancel-explain')")
    opened.wait("document.querySelector('progress')")
    opened.run("document.getElementById('cancel-explain').click()")
    opened.wait("document.body.innerText.includes('Cancelled.')")
    assert opened.run("document.querySelectorAll('progress').length") == 0


def test_a_log_that_is_dropped_while_the_server_is_away_waits_for_it(
    served: Process, opened: Browser, flight: str, tmp_path: Path
) -> None:
    opened.visit(served.address, WIDE)
    served.kill()
    opened.choose("#files", sound_log(tmp_path, "waits.csv", 3.0))
    opened.wait("document.getElementById('uploads').innerText.includes('waits for the server')")
    served.start()
    opened.wait("document.getElementById('rows').innerText.includes('waits.csv')")
    assert "waits for the server" not in opened.run("document.body.innerText")


def test_beyond_this_machine_the_printed_address_lets_in(opened: Browser, tmp_path: Path) -> None:
    with Process(tmp_path / "store", "0.0.0.0") as served:
        assert served.said.startswith(f"http://{socket.gethostname()}:{served.port}/?token=")
        opened.visit(served.address, WIDE)
        assert "needs its token" in opened.run("document.body.innerText")
        opened.visit(served.said.replace(socket.gethostname(), "127.0.0.1"), WIDE)
        opened.wait("document.documentElement.dataset.connected")
        assert opened.run("location.href") == f"{served.address}/"
        opened.visit(served.address, WIDE)
        opened.wait("document.querySelector('#drop')")


LARGE_S, DIGITS = 400.0, 92
"""Length and digits of each number of a flight table of over 100 MB."""
MOST_BYTES = 2 << 30
"""Of memory, of the server and its workers."""


@pytest.mark.long
def test_twenty_logs_at_once_and_a_kill_lose_nothing(tmp_path: Path) -> None:
    logs = [sound_log(tmp_path, f"flight{'x' * k}.parquet", 15.0) for k in range(18)]
    logs.append(sound_log(tmp_path, "large.csv", LARGE_S, DIGITS))
    assert logs[-1].stat().st_size > 100e6
    (tmp_path / "hostile.ulg").write_bytes(b"ULog\x01\x12\x35\x01" + bytes(range(256)) * 99)
    logs.append(tmp_path / "hostile.ulg")
    most, ended = 0, threading.Event()

    def watch(served: Process) -> None:
        nonlocal most
        while not ended.wait(0.2):
            try:
                server = psutil.Process(served.pid)
                all_of_it = [server, *server.children(recursive=True)]
                most = max(most, sum(p.memory_info().rss for p in all_of_it))
            except psutil.Error:  # it is being killed
                time.sleep(0.1)

    with Process(tmp_path / "store") as served:
        threading.Thread(target=watch, args=(served,), daemon=True).start()
        with browser(tmp_path) as opened:
            opened.visit(served.address, WIDE)
            opened.wait("document.documentElement.dataset.connected")
            opened.choose("#files", *logs)
            opened.wait(f"{ROWS} === 20", 120)
            opened.wait(f"{VERDICTS} >= 3", 120)
        served.kill()
        served.start()
        with browser(tmp_path) as opened:
            opened.visit(served.address, WIDE)
            opened.wait(f"{VERDICTS} === 20", 300)
            opened.wait("document.querySelectorAll('#rows .tag').length === 0", 560)
        ended.set()
    flights, count = Store(tmp_path / "store").flights()
    assert count == 20 and [f.name for f in flights if not f.why_text] == ["hostile.ulg"]
    assert 0 < most < MOST_BYTES, f"{most / 2**20:.0f} MiB"
