"""The page of `uavtwin serve`: in a thread, or as a process that can be killed."""

import contextlib
import os
import re
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from http.client import HTTPConnection
from pathlib import Path
from typing import Self

import pandas as pd
from places import IMPORT_PATH
from starlette.routing import BaseRoute
from why_rig import sound

from uavtwin.jobs.process import JobLimits
from uavtwin.serve.schedule import Limits
from uavtwin.serve.server import Site
from uavtwin.serve.store import Store
from uavtwin.site.doors import AccessPolicy
from uavtwin.site.server import SiteServer
from uavtwin.sockets import Address, listening

PATIENCE_S = 120.0


def sound_log(
    folder: Path, name: str = "sound.parquet", seconds: float = 20.0, digits: int = 9
) -> Path:
    """A flight table in which nothing is wrong; in CSV with so many digits behind the point."""
    file = folder / name
    table = pd.DataFrame(sound(seconds, seed=len(name)))
    if file.suffix == ".parquet":
        table.to_parquet(file)
    else:
        table.to_csv(file, index=False, float_format=f"%.{digits}f")
    return file


@dataclass
class Asked:
    """A site and how to ask it.

    Attributes:
        port: On this machine.
        store: Its folder.
    """

    port: int
    store: Path

    @property
    def address(self) -> str:
        return f"http://127.0.0.1:{self.port}"

    def ask(
        self,
        path: str,
        method: str = "GET",
        body: bytes = b"",
        headers: Mapping[str, str] | None = None,
    ) -> tuple[int, str, dict[str, str]]:
        """Status, text and headers of an answer."""
        connection = HTTPConnection("127.0.0.1", self.port, timeout=30)
        with contextlib.closing(connection):
            connection.request(method, path, body or None, dict(headers or {}))
            answer = connection.getresponse()
            found = {k.lower(): v for k, v in answer.getheaders()}
            return answer.status, answer.read().decode("utf-8", "replace"), found

    def wait(self, path: str, pattern: str) -> str:
        """The text of a page once it holds a pattern."""
        deadline = time.monotonic() + PATIENCE_S
        while True:
            text = self.ask(path)[1]
            if re.search(pattern, text, re.DOTALL):
                return text
            assert time.monotonic() < deadline, f"{path} never holds {pattern}: {text[-3000:]}"
            time.sleep(0.1)


@contextlib.contextmanager
def site(
    store: Path,
    workers: int = 0,
    most_bytes: int = 10_000_000,
    live: Sequence[BaseRoute] = (),
) -> Iterator[Asked]:
    """A site in a thread; without workers its jobs stay in the queue."""
    limits = Limits(JobLimits(600.0, 3.0), most_bytes, workers)
    taken, doors = listening(Address("127.0.0.1", 0), connections=True), AccessPolicy("127.0.0.1")
    made = Site(Store(store), limits, doors, live)
    try:
        with SiteServer(taken, made.app, doors) as server:
            yield Asked(server.start().port, store)
    finally:
        made.close()


class Process(Asked):
    """`uavtwin serve` as a process.

    Attributes:
        said: First line that it printed.
    """

    def __init__(self, store: Path, host: str = "127.0.0.1") -> None:
        self._host, self.said = host, ""
        with socket.create_server(("127.0.0.1", 0)) as free:
            super().__init__(int(free.getsockname()[1]), store)
        self.start()

    def start(self) -> None:
        """Start it, and wait until it answers."""
        command = "from uavtwin.cli.main import main; main()"
        listen = f"--listen={self._host}:{self.port}"
        self._process = subprocess.Popen(
            [sys.executable, "-c", command, "serve", listen, f"--store={self.store}"],
            env={**os.environ, "PYTHONPATH": IMPORT_PATH},
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
        )
        assert self._process.stdout is not None
        self.said = self._process.stdout.readline().strip()
        deadline = time.monotonic() + PATIENCE_S
        while time.monotonic() < deadline:
            with contextlib.suppress(OSError):
                if self.ask("/")[0] in (200, 403):
                    return
            time.sleep(0.1)
        raise TimeoutError("uavtwin serve does not answer")

    @property
    def pid(self) -> int:
        """Of the server."""
        return self._process.pid

    def kill(self) -> None:
        """End it as a machine does that loses its power."""
        self._process.kill()
        self._process.wait()
        assert self._process.stdout is not None
        self._process.stdout.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._process.send_signal(signal.SIGINT)
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(20)
        self.kill()
