"""Names and texts out of somebody's files, as they may be written into a TOML, into a comment and to a terminal.

Whatever a file calls its topics stays a name: it ends no string and no comment, and steers no terminal.
"""

import datetime
import json
import math
import re
import unicodedata
from collections.abc import Mapping
from typing import Any, SupportsFloat


def printable(text: str, but: str = "\n\t") -> str:
    r"""Text in which every character that a terminal would act upon, or hide, is shown by its number.

    Parameters
    ----------
    text : str
    but : str
        Characters that stay as they are.

    Examples
    --------
    >>> printable("\x1b[2Jgone\n\u202e")
    '\\x1b[2Jgone\n\\u202e'
    """
    return "".join(c if _is_harmless(c) or c in but else c.encode("unicode_escape").decode() for c in text)


def _is_harmless(c: str) -> bool:
    """Whether a character is seen, or is a space of some width."""
    return c.isprintable() or unicodedata.category(c) == "Zs"


def one_line(text: str) -> str:
    r"""The same in one line, as in a comment: a line feed is shown by its number, too.

    Examples
    --------
    >>> print("# from", one_line("/imu\n[start]"))
    # from /imu\n[start]
    """
    return printable(text, "")


def toml_text(text: str) -> str:
    r"""Text as a string of TOML, quotation marks and all.

    It is like JSON's, but TOML knows no halves of characters, and characters that nobody sees are given by number.

    Examples
    --------
    >>> print(toml_text('a"\n\x7f'))
    "a\"\n\u007f"
    """
    whole = text.encode(errors="replace").decode()
    quoted = json.dumps(whole, ensure_ascii=False)
    return "".join(
        c if _is_harmless(c) else f"\\U{ord(c):08x}" if ord(c) > 0xFFFF else f"\\u{ord(c):04x}" for c in quoted
    )


def toml_key(name: str) -> str:
    """A key as TOML has it: bare where that is allowed, else quoted.

    Examples
    --------
    >>> toml_key("compass"), toml_key("a b")
    ('compass', '"a b"')
    """
    return name if re.fullmatch(r"[A-Za-z0-9_-]+", name) else toml_text(name)


def toml_literal(value: Any) -> str:
    """A value as TOML has it, on one line.

    Examples
    --------
    >>> toml_literal({"sd": 0.5, "frozen": True})
    '{sd = 0.5, frozen = true}'
    """
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return toml_text(value)
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{toml_key(key)} = {toml_literal(part)}" for key, part in value.items()) + "}"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(toml_literal, value)) + "]"
    whole = isinstance(value, int) or not isinstance(value, SupportsFloat)
    return str(value) if whole else repr(float(value))


def json_value(value: Any) -> Any:
    """A value as JSON has it: arrays and tuples as lists, dates as texts, None for every number that is not finite."""
    if isinstance(value, Mapping):
        return {str(key): json_value(part) for key, part in value.items()}
    if hasattr(value, "tolist"):  # of NumPy
        value = value.tolist()
    if isinstance(value, list | tuple):
        return [json_value(part) for part in value]
    if isinstance(value, datetime.date):
        return value.isoformat()
    return None if isinstance(value, float) and not math.isfinite(value) else value
