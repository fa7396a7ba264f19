"""The house stands: imports point down its layers, nothing goes in circles, and no module is called after nothing in particular."""

import ast
from functools import cache
from pathlib import Path

import pytest

import navfilter

ROOT = Path(navfilter.__file__).parent
#: From the ground up; a module may import from its own floor and those below.
FLOORS = [
    {"kernels"},
    {"arma", "filter.health", "state", "filter.layout", "mission", "diagnostics", "magnetic", "filter.tape"},
    {"error_models", "learning.fit", "learning.likelihood", "learning.starts", "learning.orders", "learning.learner"},
    {"learning.learned", "sensors", "mechanisation", "vehicle", "start", "track"},
    {"learning.listener", "filter.gating", "filter.intake", "filter.adoption", "learning.rest"},
    {"filter.filter", "learning.refit"},
    {"learning.schedule", "learning.standing"},
    {"filter.history", "filter.snapshot", "navigator", "filter.smoother", "alignment"},
    {"playback", "simulation", "io", "check"},
    {"evaluation.rivals", "evaluation.consistency", "evaluation.comparison", "report", "identification"},
    {"evaluation.montecarlo", "service"},
    {"cli", "commands", "__init__", "__main__"},
]
#: Folders whose modules stand on different floors.
SPREAD = {"filter", "learning", "evaluation"}
FORBIDDEN = {"utils", "util", "common", "helpers", "helper", "misc", "tools", "base", "core"}
LONGEST_FILE = 450


def modules():
    return sorted(path for path in ROOT.rglob("*.py"))


def name_of(path):
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if len(parts) > 1 and parts[-1] == "__init__" else parts)


@cache
def tree_of(path):
    return ast.parse(path.read_text())


@cache
def imports(path, *, lazy=True):
    """Modules of the package that a file imports, as (name, whether only inside functions); `TYPE_CHECKING` blocks do not run."""
    found = set()

    def visit(node, inside):
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
            return
        inside = inside or isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
        targets = []
        if isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] == "navfilter":
            below = ".".join((node.module or "").split(".")[1:])
            for alias in node.names:
                whole = ".".join(part for part in (below, alias.name) if part)
                targets.append(whole if exists(whole) else below or "__init__")
        elif isinstance(node, ast.Import):
            targets = [".".join(alias.name.split(".")[1:]) or "__init__" for alias in node.names if alias.name.split(".")[0] == "navfilter"]
        found.update((target, inside) for target in targets)
        for child in ast.iter_child_nodes(node):
            visit(child, inside)

    visit(tree_of(path), False)
    return {target for target, inside in found if lazy or not inside}


def exists(name):
    path = ROOT.joinpath(*name.split("."))
    return path.with_suffix(".py").exists() or (path / "__init__.py").exists()


def floor(name):
    parts = name.split(".")
    place = ".".join(parts[: 2 if parts[0] in SPREAD else 1])
    return next((i for i, names in enumerate(FLOORS) if place in names), 0 if name in SPREAD else None)


def test_imports_point_down():
    wrong = []
    for path in modules():
        here = floor(name_of(path))
        for target in imports(path):
            there = floor(target)
            if here is not None and there is not None and there > here:
                wrong.append(f"{name_of(path)} imports {target}, which stands above it")
    assert wrong == []


def test_every_module_stands_on_a_floor():
    assert [name_of(path) for path in modules() if floor(name_of(path)) is None] == []


def test_nothing_below_imports_the_face():
    """The package's __init__ is for users: a module that imports it would depend on everything."""
    assert [
        name_of(path) for path in modules() if name_of(path) not in ("__init__", "__main__", "cli") and "__init__" in imports(path)
    ] == []


@pytest.mark.parametrize("lazy", [False, True])
def test_no_circles(lazy):
    """Neither at import time nor through imports inside functions."""
    arrows = {
        name_of(path): imports(path, lazy=lazy) - {name_of(path)} for path in modules() if name_of(path) not in ("__init__", "__main__")
    }
    done, path = set(), []

    def walk(name):
        if name in path:
            raise AssertionError(" -> ".join([*path[path.index(name) :], name]))
        if name in done:
            return
        path.append(name)
        for target in sorted(arrows.get(name, ())):
            walk(target)
        path.pop()
        done.add(name)

    for name in sorted(arrows):
        walk(name)


def test_kernels_import_nothing_of_the_package():
    assert {name_of(path): imports(path) for path in (ROOT / "kernels").glob("*.py") if imports(path)} == {}


def test_no_module_is_a_drawer_for_everything():
    assert [name_of(path) for path in modules() if path.stem in FORBIDDEN] == []


def test_files_stay_readable():
    """A signal, not a law: over 400 lines a file wants to be two."""
    assert {name_of(p): n for p in modules() if (n := len(p.read_text().splitlines())) > LONGEST_FILE and p.parent.name != "kernels"} == {}


def test_no_asserts_where_users_arrive():
    """Wrong input is a ValueError. An assert in a public function would vanish with -O."""
    found = []
    for path in modules():
        for node in ast.walk(tree_of(path)):
            if isinstance(node, ast.Assert) and "is not None" not in ast.unparse(node.test) and "isinstance" not in ast.unparse(node.test):
                found.append(f"{name_of(path)}:{node.lineno} {ast.unparse(node)}")
    assert found == []
