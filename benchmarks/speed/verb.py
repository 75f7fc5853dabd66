"""One verb on one flight, in a process of its own.

    python -m benchmarks.speed.verb VERB FILE MODEL

It runs as the command line runs it. The last line of its output is what that took, as JSON:
`seconds` by the clock, `processor_s`, and `peak_mb` of resident memory, the interpreter with its
packages included.
"""

import json
import sys
import tempfile
import time
from importlib import metadata
from pathlib import Path

VERBS = ("read", "check", "gap", "explain")
"""`read` is what the other three begin with."""


def run(verb: str, file: str, vehicle: str, out: str) -> None:
    """A verb as the command line runs it.

    Raises:
        SystemExit: With the exit code of the verb.
    """
    if verb == "read":
        from twin.logs import open_flight

        open_flight(file)
        return
    options = {
        "check": ["--json"],
        "gap": ["--vehicle", vehicle, "--out", out],
        "explain": ["--vehicle", vehicle, "--out", out, "--no-fmus"],
    }
    sys.argv = ["uavtwin", verb, file, *options[verb]]
    (command,) = metadata.entry_points(group="console_scripts", name="uavtwin")
    command.load()()


def peak_mb() -> float:
    """Largest resident memory of this process so far, MB; that of what started it is no part."""
    status = Path("/proc/self/status")
    if status.is_file():
        lines = status.read_text().splitlines()
        return next(int(x.split()[1]) / 1e3 * 1.024 for x in lines if x.startswith("VmHWM"))
    import resource

    size = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return size / 1e6 if sys.platform == "darwin" else size * 1.024 / 1e3


def _main() -> int:
    """Run and measure; the exit code of the verb."""
    code: object = 0
    with tempfile.TemporaryDirectory(prefix="uavtwin-") as folder:
        try:
            verb, file, vehicle = sys.argv[1:]
            run(verb, file, vehicle, str(Path(folder) / "out"))
        except SystemExit as end:
            code = end.code
    took = {
        "seconds": time.perf_counter() - _BEGIN,
        "processor_s": time.process_time(),
        "peak_mb": peak_mb(),
    }
    print(f"\n{json.dumps(took)}")
    return code if isinstance(code, int) else 0


if __name__ == "__main__":
    _BEGIN = time.perf_counter()
    sys.exit(_main())
