"""What is imported by which name: public names when they are first used, so that ``navfilter --help`` answers at once;
modules that have moved not at all.
"""

import importlib
import re
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

_PACKAGE = "navfilter."
#: A line for each module that has moved: old path and new path, without the package. Kept for one release.
_MOVED = Path(__file__).with_name("moved_modules.txt")


def lazily(package: str, file: str) -> tuple[Callable[[str], Any], Callable[[], list[str]], list[str], dict[str, str]]:
    """What a package needs to import its public names late.

    Parameters
    ----------
    package : str
        Its ``__name__``.
    file : str
        Its ``__file__``. The stub ``__init__.pyi`` beside it states each name once, for checkers and editors too:
        ``from MODULE import NAME as NAME``.

    Returns
    -------
    tuple
        ``__getattr__``, ``__dir__``, ``__all__`` and the module of each name.
    """
    stub = Path(file).with_suffix(".pyi").read_text(encoding="utf-8")
    homes = {name: module for module, name in re.findall(r"^from (\S+) import (\w+) as \2$", stub, re.MULTILINE)}
    public = sorted(name for name, module in homes.items() if module != package)

    def getattr_(name: str) -> Any:
        if name not in homes:
            # with these two Python says what may have been meant
            raise AttributeError(f"module '{package}' has no attribute '{name}'", name=name, obj=sys.modules[package])
        if homes[name] == package:
            return importlib.import_module(f"{package}.{name}")
        value = getattr(importlib.import_module(homes[name]), name)
        setattr(sys.modules[package], name, value)
        return value

    def dir_() -> list[str]:
        return sorted([*public, *(name for name in vars(sys.modules[package]) if name.startswith("__"))])

    return getattr_, dir_, public, homes


def refuse_moved(name: str) -> None:
    """Refuse a module by its old path.

    Parameters
    ----------
    name : str
        Full name of a module that nobody has found.

    Raises
    ------
    ImportError
        For one that has moved; it names the new path.

    Examples
    --------
    >>> import navfilter.sensors
    Traceback (most recent call last):
    ...
    ImportError: navfilter.sensors has moved: import navfilter.models.sensors.
    """
    moved = dict(pair.split() for pair in _MOVED.read_text(encoding="utf-8").splitlines())
    new = moved.get(name.removeprefix(_PACKAGE))
    if new is not None:
        raise ImportError(f"{name} has moved: import {_PACKAGE}{new}.", name=name)


class MovedModules:
    """Asked last where a module is: tells who imports one by an old path where it is now."""

    @staticmethod
    def find_spec(name: str, path: object = None, target: object = None) -> None:
        if name.startswith(_PACKAGE):
            refuse_moved(name)
