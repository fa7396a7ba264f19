"""The examples in the docstrings give what they print, and everything public has a docstring."""

import doctest
import importlib
import inspect
import pkgutil

import pytest

import navfilter

MODULES = sorted(
    m.name for m in pkgutil.walk_packages(navfilter.__path__, "navfilter.") if not m.name.endswith("__main__")
)


@pytest.mark.parametrize("name", MODULES)
def test_examples(name):
    result = doctest.testmod(importlib.import_module(name), optionflags=doctest.NORMALIZE_WHITESPACE | doctest.ELLIPSIS)
    assert result.failed == 0


@pytest.mark.parametrize("name", [n for n in MODULES if ".kernels" not in n])
def test_public_names_are_documented(name):
    module = importlib.import_module(name)
    bare = [
        key
        for key, thing in vars(module).items()
        if not key.startswith("_")
        and (inspect.isfunction(thing) or inspect.isclass(thing))
        and thing.__module__ == name
        and not (inspect.getdoc(thing) or "").strip()
    ]
    assert not bare, f"without docstring: {bare}"
    assert (module.__doc__ or "").strip(), "the module has no docstring"
