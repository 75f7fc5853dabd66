"""The whole benchmark: `python -m benchmarks.hidden_effects --subset 120 --jobs 2 --out DIR`.

Flights, what `explain` says about them, the table. All of it goes on where it was stopped.
"""

import argparse
from pathlib import Path

from . import generate, run
from .score import write_score


def main(arguments: list[str] | None = None) -> int:
    """Command line; exit code 1 when a case failed."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.hidden_effects", description=(__doc__ or "").splitlines()[0]
    )
    parser.add_argument("--out", type=Path, required=True, help="folder to write to")
    generate.add_options(parser)
    run.add_options(parser)
    options = parser.parse_args(arguments)
    wanted = generate.chosen(options)
    generate.generate(options.out, wanted, options.jobs)
    ids = {case.id for case in wanted}
    failed = run.run(options.out, options.results, options.jobs, ids, options.again)
    return write_score(options.out, options.results, ids) or failed


if __name__ == "__main__":
    raise SystemExit(main())
