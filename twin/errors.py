"""Errors a user can mend: each text names the file, the quantity, the value and the way out."""


class TwinError(Exception):
    """Base of everything that is wrong with a user's input rather than with this program."""


class LogError(TwinError):
    """A flight log or flight table cannot be read or lacks what was asked of it."""


class NoLogError(LogError):
    """A file is no flight log, whole or damaged."""


class ModelError(TwinError):
    """A vehicle file, a parameter or a model equation is not usable."""


class FmuError(TwinError):
    """An FMU cannot be built, read or stepped."""


def install_command(extra: str) -> str:
    """The command that installs what an optional dependency group of this package needs.

    It names the packages, with the versions of the group, since they can be had by name from a
    package index while this package itself may have been installed from its source folder.

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
