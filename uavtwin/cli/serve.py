"""`uavtwin serve`: a page where one drops flight logs."""

from pathlib import Path
from typing import Annotated

import typer

from twin.errors import TwinError

from .options import of_unit, seconds
from .printing import STDERR, STDOUT


def serve(
    listen: Annotated[
        str,
        typer.Option(
            help="Address of the page, HOST:PORT; beyond loopback a token is needed, which is "
            "printed."
        ),
    ] = "127.0.0.1:8080",
    store: Annotated[
        Path, typer.Option(help="Folder of logs, results and the list of flights; made if needed.")
    ] = Path("uavtwin-store"),
    workers: Annotated[int, typer.Option(min=1, max=64, help="Processes that look at logs.")] = 2,
    size_limit: Annotated[float, of_unit("MiB", "MIB", help="Of one log, MiB.")] = 1024.0,
    time_limit: Annotated[
        float,
        seconds("Of explain or FMUs of one flight, s; a third of it for everything else."),
    ] = 1800.0,
    memory_limit: Annotated[
        float, of_unit("GiB", "GIB", help="Address space of a process that looks at a log, GiB.")
    ] = 3.0,
) -> None:
    """Serve a page where one drops flight logs and reads what check, why, gap and explain say.

    Nothing leaves this machine. Ends with Ctrl-C; interrupted jobs are resumed at the next start.
    """
    from ..jobs.process import JobLimits
    from ..serve.opened import open_site
    from ..serve.schedule import Limits

    if not 0 < size_limit < float("inf"):
        raise TwinError(f"--size-limit {size_limit:g}: needs a positive number.")
    limits = Limits(JobLimits(time_limit, memory_limit), int(size_limit * 2**20), workers)
    with open_site(listen, "--listen", store, limits) as (server, _):
        STDOUT.print(server.url)
        STDERR.print(f"store: {store}; end with Ctrl-C")
        server.run()
