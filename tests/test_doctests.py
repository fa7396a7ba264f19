"""The examples in the docstrings give what they print, and everything public has a docstring."""

import doctest
import importlib.util
import inspect
import pkgutil
import re
from pathlib import Path

import pytest

import navfilter

MODULES = sorted(
    m.name for m in pkgutil.walk_packages(navfilter.__path__, "navfilter.") if not m.name.endswith("__main__")
)
EXAMPLES = [
    name for name in MODULES if ">>>" in Path(importlib.util.find_spec(name).origin).read_text(encoding="utf-8")
]


@pytest.mark.parametrize("name", EXAMPLES)
def test_examples(name):
    result = doctest.testmod(importlib.import_module(name), optionflags=doctest.NORMALIZE_WHITESPACE | doctest.ELLIPSIS)
    assert result.failed == 0


def test_modules_and_public_names_are_documented():
    modules = [importlib.import_module(name) for name in MODULES]
    bare = [
        f"{module.__name__}.{key}"
        for module in modules
        if ".kernels" not in module.__name__
        for key, thing in vars(module).items()
        if not key.startswith("_")
        and (inspect.isfunction(thing) or inspect.isclass(thing))
        and thing.__module__ == module.__name__
        and not (inspect.getdoc(thing) or "").strip()
    ]
    bare += [module.__name__ for module in modules if not (module.__doc__ or "").strip()]
    assert not bare, f"without docstring: {bare}"


def test_what_docstrings_name_is_there():
    """``navfilter.foundation.state_values.copied`` in a docstring leads somewhere."""
    package = Path(navfilter.__file__).parent
    named = {
        name for path in package.rglob("*.py") for name in re.findall(r"`(navfilter(?:\.\w+)+)`", path.read_text())
    }
    assert len(named) > 20  # a pattern that finds nothing would find nothing wrong
    assert [name for name in sorted(named) if not leads_somewhere(name)] == []


def leads_somewhere(name):
    parts = name.split(".")
    for k in range(len(parts), 0, -1):
        try:
            found = importlib.import_module(".".join(parts[:k]))
        except ImportError:
            continue
        for part in parts[k:]:
            found = getattr(found, part, None)
        return found is not None
    return False
