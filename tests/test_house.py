"""The house stands: imports point down its layers, nothing goes in circles, and no module is called after nothing in
particular.
"""

import ast
from functools import cache
from pathlib import Path

import pytest

import navfilter

ROOT = Path(navfilter.__file__).parent
#: From the ground up; a module may import from its own floor and those below.
FLOORS = [
    {"kernels", "constants", "compilation", "known_calls", "utc"}
    | {"handed_over", "descriptions", "notebook"}
    | {"filter.memory", "filter.health", "filter.integrity", "filter.spool"},
    {
        "arma",
        "state",
        "mapped",
        "mission",
        "diagnostics",
        "magnetic",
        "filter.layout",
        "filter.tape",
        "filter.offsets",
        "error_models",
        "cycle",
        "learning.drift",
    },
    {
        "learning.low_frequency",
        "learning.limits",
        "learning.spikes",
        "learning.spectrum",
        "learning.nearest",
        "learning.slow",
        "learning.effort",
        "learning.likelihood",
        "learning.starts",
        "learning.fit",
        "learning.posterior",
        "learning.alike",
        "learning.unseen",
        "learning.quick",
        "learning.learner_memory",
        "learning.learnt",
        "learning.learner",
        "learning.learned",
        "learning.bias",
        "start",
    },
    {"sensors", "mechanisation", "vehicle", "track", "track_plot", "track_views"},
    {
        "filter",
        "learning.worker",
        "learning.conflict",
        "learning.doubtful",
        "learning.kept",
        "learning.belief",
        "learning.listener",
        "learning.listener_memory",
        "learning.rest",
        "learning.refit",
        "learning.learning_memory",
    },
    {
        "learning.schedule",
        "navigator_memory",
        "beginning",
        "navigator",
        "readings",
        "passage",
        "passage_again",
        "prompt",
    },
    {"lane_clock", "lane_missions", "alignment"},
    {
        "assembly",
        "track_bounds",
        "track_trust",
        "recorded",
        "lanes",
        "lane_replay",
        "lane_tracks",
        "playback",
        "beacons",
        "warming",
        "simulation",
        "io",
        "outputs",
        "check",
    },
    {"evaluation", "report", "identification", "calibration"},
    {"service", "cli", "commands", "__init__", "__main__"},
]
#: Folders whose modules stand on different floors.
SPREAD = {"filter", "learning"}
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
    """Modules of the package that a file imports, as (name, whether only inside functions); `TYPE_CHECKING` blocks do
    not run.
    """
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
            targets = [
                ".".join(alias.name.split(".")[1:]) or "__init__"
                for alias in node.names
                if alias.name.split(".")[0] == "navfilter"
            ]
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
    places = (".".join(parts[:2]), parts[0]) if parts[0] in SPREAD else (parts[0],)
    found = (i for place in places for i, names in enumerate(FLOORS) if place in names)
    return next(found, 0 if name in SPREAD else None)


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
        name_of(path)
        for path in modules()
        if name_of(path) not in ("__init__", "__main__", "cli") and "__init__" in imports(path)
    ] == []


@pytest.mark.parametrize("lazy", [False, True])
def test_no_circles(lazy):
    """Neither at import time nor through imports inside functions."""
    arrows = {
        name_of(path): imports(path, lazy=lazy) - {name_of(path)}
        for path in modules()
        if name_of(path) not in ("__init__", "__main__")
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
    found = {name_of(path): imports(path) for path in (ROOT / "kernels").glob("*.py")}
    foreign = {name: {other for other in others if not other.startswith("kernels")} for name, others in found.items()}
    assert {name: others for name, others in foreign.items() if others} == {}


def test_no_module_is_a_drawer_for_everything():
    assert [name_of(path) for path in modules() if path.stem in FORBIDDEN] == []


def test_files_stay_readable():
    """A signal, not a law: over 400 lines a file wants to be two."""
    assert {
        name_of(p): n
        for p in modules()
        if (n := len(p.read_text().splitlines())) > LONGEST_FILE and p.parent.name != "kernels"
    } == {}


def test_no_asserts_where_users_arrive():
    """Wrong input is a ValueError. An assert in a public function would vanish with -O."""
    found = []
    for path in modules():
        for node in ast.walk(tree_of(path)):
            if (
                isinstance(node, ast.Assert)
                and "is not None" not in ast.unparse(node.test)
                and "isinstance" not in ast.unparse(node.test)
            ):
                found.append(f"{name_of(path)}:{node.lineno} {ast.unparse(node)}")
    assert found == []


@cache
def kinds_of(base):
    """Names of all classes of the package below one, by the base classes as they are written."""
    found, tree = (
        {base},
        [
            node
            for path in modules()
            for node in ast.walk(ast.parse(path.read_text()))
            if isinstance(node, ast.ClassDef)
        ],
    )
    while (
        new := {node.name for node in tree if found & {ast.unparse(b).rsplit(".", 1)[-1] for b in node.bases}} - found
    ):
        found |= new
    return found - {base}


def names_in(node):
    return {getattr(part, "attr", getattr(part, "id", None)) for part in ast.walk(node)}


#: Where each family of kinds is at home.
HOMES = {"Sensor": "sensors", "Mechanisation": "mechanisation"}
#: What may ask for one drive: the simulator draws an inertial unit's triples, learning at rest is about nothing else.
EXCEPTIONS = {("simulation.simulate", "Imu"), ("learning.rest", "Imu"), ("io.vehicle_toml", "Coasting")}


@pytest.mark.parametrize("base", HOMES)
def test_kinds_speak_for_themselves(base):
    """Whoever needs to know what kind of sensor or drive he has asks it: no isinstance, no type(...), no name of a
    class elsewhere.
    """
    kinds = kinds_of(base)
    assert len(kinds) >= 2
    wrong = []
    for path in modules():
        name = name_of(path)
        if name.split(".")[0] == HOMES[base]:
            continue
        for node in ast.walk(ast.parse(path.read_text())):
            asks = isinstance(node, ast.Call) and getattr(node.func, "id", "") in ("isinstance", "issubclass")
            if asks or (isinstance(node, ast.Compare) and "type(" in ast.unparse(node)):
                named = names_in(node) | {part.value for part in ast.walk(node) if isinstance(part, ast.Constant)}
                wrong += [f"{name}:{node.lineno} {kind}" for kind in kinds & named if (name, kind) not in EXCEPTIONS]
    assert wrong == []


def test_there_is_no_list_of_kinds():
    """No table of a module that stands outside the kinds' own home has two of them as keys or members."""
    wrong = []
    for path in modules():
        name = name_of(path)
        for node in ast.parse(path.read_text()).body:
            value = getattr(node, "value", None) if isinstance(node, ast.Assign | ast.AnnAssign) else None
            if value is None or name.split(".")[0] in HOMES.values():
                continue
            for part in ast.walk(value):
                members = (
                    part.keys
                    if isinstance(part, ast.Dict)
                    else part.elts
                    if isinstance(part, ast.Tuple | ast.List | ast.Set)
                    else []
                )
                named = [
                    kind
                    for kind in kinds_of("Sensor")
                    for member in members
                    if member is not None and kind in names_in(member)
                ]
                if len(named) > 1:
                    wrong.append(f"{name}:{node.lineno}")
    assert wrong == []


def test_nothing_inherits_from_the_filter():
    """It is a part, and tells what it does; learning and navigator compose."""
    bases = {
        f"{name_of(path)}.{node.name}": [ast.unparse(base) for base in node.bases]
        for path in modules()
        for node in ast.walk(tree_of(path))
        if isinstance(node, ast.ClassDef)
    }
    parts = {"Filter", "LearningSchedule", "Navigator", "History", "Intake", "Channel", "Listener", "RestRecorder"}
    assert {name: found for name, found in bases.items() if parts & set(found)} == {}


#: Names with an underscore that other libraries mean to be used: named tuples, what a kernel is built of, a time stamp.
OPEN = {
    *("context.active_code_library._reload_init", "state.library._reload_init", "state.library._final_module"),
    *("view._getvalue", "colours._markup"),
    *("_replace", "_fields", "_asdict", "os._exit", "message._timestamp"),
}


def test_nobody_reaches_into_the_privates_of_another():
    """A private name is for its own class: of `self`, or of another object of the same class where a class method makes
    one.
    """
    wrong = []
    for path in modules():
        tree = tree_of(path)
        own = {}
        for kind in ast.walk(tree):
            if isinstance(kind, ast.ClassDef):
                names = {
                    n.attr for n in ast.walk(kind) if isinstance(n, ast.Attribute) and ast.unparse(n.value) == "self"
                }
                names |= {n.name for n in ast.walk(kind) if isinstance(n, ast.FunctionDef)}
                own |= {id(n): names for n in ast.walk(kind)}
        for node in ast.walk(tree):
            if not isinstance(node, ast.Attribute) or not node.attr.startswith("_") or node.attr.startswith("__"):
                continue
            text = ast.unparse(node)
            of_self = isinstance(node.value, ast.Name) and node.value.id in ("self", "cls")
            if not (of_self or text in OPEN or node.attr in OPEN or node.attr in own.get(id(node), ())):
                wrong.append(f"{name_of(path)}:{node.lineno} {text}")
    assert wrong == []
