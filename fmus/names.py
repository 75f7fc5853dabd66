"""Names and texts that come from a file: what may stand in one before it enters C, XML or a path.

An FMU is code that other tools load. What a file says about itself is data, of any author: a
name that is no short identifier is refused where it is read, and again where it is written.
"""

import re

from twin.errors import FmuError

LONGEST_NAME = 64
"""Of a name that a file gives."""
LONGEST_VARIABLE = 256
"""Of a variable of an FMU, the names of its part and of what it stands for together."""
LONGEST_TEXT = 1000
"""Of a description."""
_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_.]*")
_IDENTIFIER = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")


def check_name(where: str, name: object, longest: int = LONGEST_NAME) -> str:
    """The name, if it is one: a letter or _, then letters, digits, _ and dots, all of ASCII.

    Args:
        where: File and quantity, for the message.
        name: What stands there.
        longest: Characters it may have.

    Raises:
        FmuError: It is no name.
    """
    return _checked(where, name, _NAME, "letters, digits, _ and dots", longest)


def check_variable(where: str, name: object) -> str:
    """The name of a variable of an FMU; that of a derivative is `der(...)`, as in FMI 2.2.9.

    Raises:
        FmuError: It is none.
    """
    if isinstance(name, str) and name.startswith("der(") and name.endswith(")"):
        return f"der({check_name(where, name[4:-1], LONGEST_VARIABLE)})"
    return check_name(where, name, LONGEST_VARIABLE)


def check_identifier(where: str, name: object, longest: int = LONGEST_NAME) -> str:
    """The same without dots: an identifier of C.

    Raises:
        FmuError: It is none.
    """
    return _checked(where, name, _IDENTIFIER, "letters, digits and _", longest)


def check_text(where: str, text: object, longest: int = LONGEST_TEXT) -> str:
    """The text, if it is one line that can be printed, of any script.

    Raises:
        FmuError: It is not.
    """
    if not isinstance(text, str) or len(text) > longest or not text.isprintable():
        raise FmuError(
            f"{where} = {shown(text)} is no text: write one line without control characters, "
            f"{longest} characters at most."
        )
    return text


def shown(value: object, longest: int = 80) -> str:
    """A value of a file in a message: plain ASCII on one line, cut where it is long."""
    text = ascii(value[: longest + 1] if isinstance(value, str) else value)
    return text if len(text) <= longest else f"{text[:longest]}..."


def _checked(where: str, name: object, pattern: re.Pattern[str], allowed: str, longest: int) -> str:
    if not isinstance(name, str) or len(name) > longest or not pattern.fullmatch(name):
        raise FmuError(
            f"{where} = {shown(name)} is no name: write a letter or _, then {allowed}, "
            f"{longest} characters at most."
        )
    return name
