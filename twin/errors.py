"""Errors that a user can correct: each text names the file, the quantity, the value and the
remedy."""


class TwinError(Exception):
    """Base of all errors in a user's input, as opposed to errors in this program."""


class LogError(TwinError):
    """A flight log or flight table cannot be read or lacks required data."""


class NoLogError(LogError):
    """A file is no flight log, complete or damaged."""


class ModelError(TwinError):
    """A vehicle file, a parameter or a model equation is not usable."""


class FmuError(TwinError):
    """An FMU cannot be built, read or stepped."""


def install_command(extra: str) -> str:
    """Command that installs an optional dependency group of this package.

    It names the packages with the versions of the group, which are available from a package index,
    while this package itself may have been installed from its source folder.

    Args:
        extra: Name of the group in pyproject.toml.
    """
    from importlib.metadata import PackageNotFoundError, requires
    from shlex import quote

    try:
        group = [
            r.partition(";")[0].strip()
            for r in requires("uavtwin") or ()
            if f"extra == '{extra}'" in r
        ]
    except PackageNotFoundError:
        group = []
    return f"pip install {' '.join(map(quote, group)) or quote(f'.[{extra}]')}"
