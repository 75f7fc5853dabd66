"""A headless Chromium, spoken to over its debugging pipe: one process looks at many pages."""

import contextlib
import json
import os
import select
import shutil
import subprocess
import time
from base64 import b64decode
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import pytest
from places import needs

BROWSER = shutil.which("chromium") or shutil.which("google-chrome")
needs_browser = needs(BROWSER is not None, "no chromium: apt-get install chromium")
_FLAGS = (
    "--headless=new",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-dev-shm-usage",
    "--disable-background-networking",
    "--disable-extensions",
    "--no-first-run",
    "--hide-scrollbars",
    "--remote-debugging-pipe",
    "about:blank",
)
_PATIENCE_S = 180.0  # a machine that is busy opens a page in a minute


@dataclass(frozen=True, slots=True)
class View:
    """How a page is looked at.

    Attributes:
        width: Of the window, pixels.
        dark: Whether the reader prefers dark colours.
    """

    width: int
    dark: bool

    def __str__(self) -> str:
        return f"{self.width}{'dark' if self.dark else 'light'}"


VIEWS = tuple(View(width, dark) for width in (1300, 412) for dark in (False, True))
SOME_VIEWS = [
    v if k in (0, 3) else pytest.param(v, marks=pytest.mark.long) for k, v in enumerate(VIEWS)
]
"""Both widths and both colours once; the other two combinations are `long`."""


class Browser:
    """One page of a browser.

    Attributes:
        complaints: Errors on the console and exceptions since the page was opened.
        requests: Addresses that it asked for since then, itself and data left out.
    """

    def __init__(self, profile: Path) -> None:
        if BROWSER is None:
            raise FileNotFoundError("chromium")
        (theirs_in, self._out), (self._in, theirs_out) = os.pipe(), os.pipe()

        def pipes() -> None:
            """The browser reads from 3 and writes to 4."""
            spare_in, spare_out = os.dup(theirs_in), os.dup(theirs_out)
            os.dup2(spare_in, 3)
            os.dup2(spare_out, 4)

        self._process = subprocess.Popen(
            # the profile's folder is the test's own, its cache goes with it
            [BROWSER, f"--user-data-dir={profile}", *_FLAGS],
            preexec_fn=pipes,
            close_fds=False,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        os.close(theirs_in)
        os.close(theirs_out)
        self._read = b""
        self._count = 0
        self._session: str | None = None
        self._loaded = False
        self.complaints: list[str] = []
        self.requests: list[str] = []
        targets = self._ask("Target.getTargets")["targetInfos"]
        page = next(t["targetId"] for t in targets if t["type"] == "page")
        self._attach(page)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        try:
            self._session = None
            self._ask("Browser.close")
            self._process.wait(10)
        except (OSError, TimeoutError, subprocess.TimeoutExpired):
            self._process.kill()
            self._process.wait()
        os.close(self._in)
        os.close(self._out)

    def open(self, page: Path, view: View) -> None:
        """Open a page and wait until all its figures are drawn."""
        self.visit(page.resolve().as_uri(), view)

    def visit(self, address: str, view: View) -> None:
        """Open an address and wait until it is loaded."""
        self.complaints.clear()
        self.requests.clear()
        self._ask(
            "Emulation.setDeviceMetricsOverride",
            width=view.width,
            height=900,
            deviceScaleFactor=1,
            mobile=False,
        )
        scheme = "dark" if view.dark else "light"
        feature = [{"name": "prefers-color-scheme", "value": scheme}]
        self._ask("Emulation.setEmulatedMedia", features=feature)
        self._loaded = False
        if "loaderId" not in self._ask("Page.navigate", url=address):
            return  # another place of the same page
        deadline = time.monotonic() + _PATIENCE_S
        while not self._loaded:
            self._note(self._next(deadline))

    def run(self, script: str) -> Any:
        """The value of an expression in the page; a promise is awaited."""
        answer = self._ask(
            "Runtime.evaluate", expression=script, awaitPromise=True, returnByValue=True
        )
        if "exceptionDetails" in answer:
            raise RuntimeError(f"in the page: {answer['exceptionDetails']}")
        return answer["result"].get("value")

    def choose(self, selector: str, *files: Path) -> None:
        """Choose files in an input of the page."""
        root = self._ask("DOM.getDocument")["root"]["nodeId"]
        found = self._ask("DOM.querySelector", nodeId=root, selector=selector)["nodeId"]
        paths = [str(f.resolve()) for f in files]
        self._ask("DOM.setFileInputFiles", nodeId=found, files=paths)

    def drop(self, selector: str, *files: Path) -> None:
        """Drop files on an element of the page, as a mouse does."""
        box = f"(e => e.getBoundingClientRect())(document.querySelector({selector!r}))"
        x, y = (float(self.run(f"{box}.{a} + 20")) for a in ("left", "top"))
        data = {
            "items": [],
            "files": [str(f.resolve()) for f in files],
            "dragOperationsMask": 1,
        }
        for kind in ("dragEnter", "dragOver", "drop"):
            self._ask("Input.dispatchDragEvent", type=kind, x=x, y=y, data=data)

    def press(self, key: str, text: str = "") -> None:
        """Press a key and let it go."""
        codes = {"Tab": 9, "Enter": 13, " ": 32}
        about = {"key": key, "code": key, "windowsVirtualKeyCode": codes.get(key, 0)}
        text = text or {"Enter": "\r", " ": " "}.get(key, "")
        self._ask("Input.dispatchKeyEvent", type="keyDown", text=text, **about)
        self._ask("Input.dispatchKeyEvent", type="keyUp", **about)

    def wait(self, condition: str, within_s: float = _PATIENCE_S) -> None:
        """Until an expression is true in the page, whichever is open by then."""
        deadline = time.monotonic() + within_s
        while True:
            with contextlib.suppress(RuntimeError):  # between two pages there is none
                if self.run(f"Boolean({condition})"):
                    return
            if time.monotonic() > deadline:
                text = self.run("document.body.innerText.slice(0, 2000)")
                raise TimeoutError(f"not within {within_s:g} s: {condition}\n{text}")
            time.sleep(0.05)

    @contextmanager
    def tab(self) -> Iterator[None]:
        """Another page of the same browser; the first one stays open meanwhile."""
        first, self._session = self._session, None
        target = str(self._ask("Target.createTarget", url="about:blank")["targetId"])
        try:
            self._attach(target)
            yield
        finally:
            self._session = None
            self._ask("Target.closeTarget", targetId=target)
            self._session = first

    def _attach(self, target: str) -> None:
        """Speak to a page."""
        attached = self._ask("Target.attachToTarget", targetId=target, flatten=True)
        self._session = str(attached["sessionId"])
        for domain in ("Page", "Runtime", "Log", "Network"):
            self._ask(f"{domain}.enable")

    def picture(self, file: Path, most_px: int = 12_000, top_px: int = 0) -> None:
        """The page from a height on as a PNG, cut below so many pixels."""
        size = self._ask("Page.getLayoutMetrics")["cssContentSize"]
        clip = {
            "x": 0,
            "y": top_px,
            "width": size["width"],
            "height": min(size["height"] - top_px, most_px),
            "scale": 1,
        }
        shot = self._ask("Page.captureScreenshot", captureBeyondViewport=True, clip=clip)
        file.write_bytes(b64decode(shot["data"]))

    def _ask(self, method: str, **parameters: Any) -> dict[str, Any]:
        self._count += 1
        message: dict[str, Any] = {"id": self._count, "method": method, "params": parameters}
        if self._session is not None:
            message["sessionId"] = self._session
        os.write(self._out, json.dumps(message).encode() + b"\0")
        deadline = time.monotonic() + _PATIENCE_S
        while True:
            answer = self._next(deadline)
            if answer.get("id") == self._count:
                if "error" in answer:
                    raise RuntimeError(f"{method}: {answer['error']}")
                return dict(answer["result"])
            self._note(answer)

    def _next(self, deadline: float) -> dict[str, Any]:
        while b"\0" not in self._read:
            ready, _, _ = select.select([self._in], [], [], max(0.0, deadline - time.monotonic()))
            if not ready:
                raise TimeoutError(f"no answer from {BROWSER} for {_PATIENCE_S:g} s")
            part = os.read(self._in, 1 << 20)
            if not part:
                raise ConnectionError(f"{BROWSER} has ended")
            self._read += part
        message, _, self._read = self._read.partition(b"\0")
        return dict(json.loads(message))

    def _note(self, event: Mapping[str, Any]) -> None:
        """Keep what a page should not do."""
        method, about = event.get("method"), event.get("params", {})
        if method == "Page.loadEventFired":
            self._loaded = True
        elif method == "Runtime.exceptionThrown":
            self.complaints.append(str(about["exceptionDetails"]))
        elif method == "Runtime.consoleAPICalled" and about["type"] in ("error", "warning"):
            self.complaints.append(str(about["args"]))
        elif method == "Log.entryAdded" and about["entry"]["level"] == "error":
            self.complaints.append(about["entry"]["text"])
        elif method == "Network.requestWillBeSent":
            address = str(about["request"]["url"])
            if not address.startswith(("file:", "data:", "blob:")):
                self.requests.append(address)


def pictures(folder: Path) -> Path:
    """Where pictures are kept: in the folder of $UAVTWIN_PICTURES, else where the test says."""
    return Path(os.environ.get("UAVTWIN_PICTURES", folder))


def faults(opened: Browser, page: Path, view: View, picture: Path | None = None) -> list[str]:
    """What is wrong with a page as somebody sees it; all its figures are drawn.

    Args:
        opened: A browser.
        page: HTML file.
        view: Width and colours.
        picture: PNG to write; None: none is kept.
    """
    opened.open(page, view)
    found = faults_shown(opened)
    if picture is not None:
        picture.parent.mkdir(parents=True, exist_ok=True)
        opened.picture(picture, 6000)
    found += [f"on the console: {c}" for c in opened.complaints]
    return found + [f"asks for {r}" for r in opened.requests]


def faults_shown(opened: Browser) -> list[str]:
    """What is wrong with the page that is open, as somebody sees it; all its figures are drawn."""
    return [str(f) for f in opened.run(_MEASURE)]


def tables_cut(opened: Browser) -> list[str]:
    """First headers of tables that are wider than the page shows without scrolling."""
    wide = (
        "[...document.querySelectorAll('.scroll')].filter(e => e.scrollWidth > e.clientWidth + 1)"
    )
    return [str(x) for x in opened.run(f"{wide}.map(e => e.innerText.slice(0, 80))")]


_MEASURE = (Path(__file__).with_name("measure_page.js")).read_text("utf-8")


@contextmanager
def browser(folder: Path) -> Iterator[Browser]:
    """A browser with a profile of its own in a folder."""
    with Browser(folder / "profile") as opened:
        yield opened
