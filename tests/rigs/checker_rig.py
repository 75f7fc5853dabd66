"""What independent checkers say of an FMU: FMPy and the FMU manipulation toolbox."""

import logging
from pathlib import Path

from fmpy.validation import validate_fmu
from fmu_manipulation_toolbox.checker import get_checkers
from fmu_manipulation_toolbox.cli.utils import ErrorCounter
from fmu_manipulation_toolbox.operations import FMU


def problems(path: Path) -> list[str]:
    """What they find."""
    logger, errors = logging.getLogger("fmu_manipulation_toolbox"), ErrorCounter()
    logger.addHandler(errors)
    try:
        with FMU(str(path)) as fmu:
            for checker in get_checkers():
                fmu.apply_operation(checker())
    finally:
        logger.removeHandler(errors)
    found = [f"{errors.count} errors of the toolbox"] if errors.count else []
    return [*validate_fmu(str(path)), *found]
