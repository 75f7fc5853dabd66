"""Errors a user can mend: each text names the file, the quantity, the value and the way out."""


class TwinError(Exception):
    """Base of everything that is wrong with a user's input rather than with this program."""


class LogError(TwinError):
    """A flight log or flight table cannot be read or lacks what was asked of it."""


class ModelError(TwinError):
    """A vehicle file, a parameter or a model equation is not usable."""


class FmuError(TwinError):
    """An FMU cannot be built, read or stepped."""
