"""The house stands: imports point down its layers, nothing goes in circles, and the filter alone changes its state.

Imports for types and those inside functions count like all others. ``python tests/test_house.py`` prints the figures.
"""

import ast
import sys
from collections import defaultdict
from functools import cache
from pathlib import Path

import pytest

import navfilter

ROOT = Path(navfilter.__file__).parent
#: Rooms, from the ground up; none imports from its own layer or one above.
LAYERS = (
    ("foundation", "kernels"),
    ("timeseries",),
    ("models",),
    ("filter", "simulation"),
    ("faults", "learning", "track"),
    ("navigation", "rendering", "io"),
    ("check", "playback"),
    ("calibration", "identification", "service"),
    ("evaluation",),
    ("report",),
    ("commands",),
    ("__init__", "__main__"),
)
FORBIDDEN = {"utils", "util", "common", "helpers", "helper", "misc", "tools", "base", "core"}
MOST_ROOMS, MOST_FLOORS, MOST_LINES, MOST_OF_OWN_FOLDER = 25, 12, 600, 12
#: Below so many lines a module is a part of its only importer, unless it is a format, a kind, a part of the compiler or
#: a page of its own.
SHORT = 80
OF_THEIR_OWN = (
    "io",
    "filter.rts_smoother",
    "models.sensors",
    "models.mechanisation",
    "kernels",
    "commands",
    "check",
    "report",
    "simulation",
)


def modules():
    return sorted(ROOT.rglob("*.py"))


def name_of(path):
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if len(parts) > 1 and parts[-1] == "__init__" else parts)


@cache
def tree_of(path):
    return ast.parse(path.read_text())


def exists(name):
    path = ROOT.joinpath(*name.split("."))
    return path.with_suffix(".py").exists() or (path / "__init__.py").exists()


@cache
def imports(path):
    """Modules of the package that a file, or the stub beside it, imports, wherever in it."""
    found, stub = set(), path.with_suffix(".pyi")
    for node in [*ast.walk(tree_of(path)), *(ast.walk(tree_of(stub)) if stub.exists() else ())]:
        if isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] == "navfilter":
            below = ".".join((node.module or "").split(".")[1:])
            for alias in node.names:
                whole = ".".join(part for part in (below, alias.name) if part)
                found.add(whole if exists(whole) else below or "__init__")
        elif isinstance(node, ast.Import):
            own = [alias.name for alias in node.names if alias.name.split(".")[0] == "navfilter"]
            found |= {name.partition(".")[2] or "__init__" for name in own}
    return found - {name_of(path)}


def room(name):
    return name.split(".")[0]


@cache
def arrows():
    """Rooms that a room imports from."""
    found = defaultdict(set)
    for path in modules():
        found[room(name_of(path))] |= {room(target) for target in imports(path)} - {room(name_of(path))}
    return dict(found)


@cache
def floor(name):
    """On which floor a room stands: one above the highest that it imports from."""
    return 1 + max((floor(other) for other in arrows()[name]), default=0)


def layer(name):
    return next(i for i, rooms in enumerate(LAYERS) if room(name) in rooms)


def test_every_room_has_its_layer():
    assert set(arrows()) == {name for rooms in LAYERS for name in rooms}


def test_imports_point_down():
    wrong = []
    for path in modules():
        here = name_of(path)
        for target in imports(path):
            if room(here) != room(target) and here not in ("__init__", "__main__") and layer(target) >= layer(here):
                wrong.append(f"{here} imports {target}, which stands no lower")
    assert wrong == []


def test_nothing_below_imports_the_face():
    """The package's __init__ is for users: a module that imports it would depend on everything."""
    inside = {name_of(path): imports(path) for path in modules()}
    assert [name for name, targets in inside.items() if "__init__" in targets and name != "commands.cli"] == []


def circles():
    """Groups of files that import each other."""
    targets = {name_of(path): sorted(imports(path)) for path in modules() if name_of(path) != "__init__"}
    index, low, stack, found = {}, {}, [], []

    def visit(name):
        index[name] = low[name] = len(index)
        stack.append(name)
        for target in targets[name]:
            if target in targets and target not in index:
                visit(target)
            if target in stack:
                low[name] = min(low[name], low[target])
        if low[name] == index[name]:
            group = [stack.pop()]
            while group[-1] != name:
                group.append(stack.pop())
            if len(group) > 1:
                found.append(sorted(group))

    for name in targets:
        if name not in index:
            visit(name)
    return found


def test_no_circles():
    assert circles() == []


def test_the_house_is_small():
    assert len(arrows()) <= MOST_ROOMS
    assert max(map(floor, arrows())) <= MOST_FLOORS
    own = ["__init__.py", "__init__.pyi", "__main__.py", "py.typed"]
    assert sorted(path.name for path in ROOT.iterdir() if path.is_file()) == own


def test_kernels_import_nothing_of_the_package():
    found = {name_of(path): imports(path) for path in (ROOT / "kernels").rglob("*.py")}
    foreign = {name: {other for other in others if not other.startswith("kernels")} for name, others in found.items()}
    assert {name: others for name, others in foreign.items() if others} == {}


def test_instructions_are_built_by_the_compiler_alone():
    """An algorithm reads like the book: what builds instructions for it stands in `kernels.compiling`."""
    wrong = [
        name_of(path)
        for path in modules()
        if not name_of(path).startswith("kernels.compiling") and "builder." in path.read_text()
    ]
    assert wrong == []


def test_no_module_is_a_drawer_for_everything():
    assert [name_of(path) for path in modules() if path.stem in FORBIDDEN] == []


def code_lines(path):
    """Lines that are neither blank, nor comments, nor docstrings."""
    lines = {n for n, text in enumerate(path.read_text().splitlines(), 1) if text.strip() and text.strip()[0] != "#"}
    for node in ast.walk(tree_of(path)):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str):
            lines -= set(range(node.lineno, node.end_lineno + 1))
    return len(lines)


def test_files_stay_readable():
    assert {name_of(p): n for p in modules() if (n := code_lines(p)) > MOST_LINES and p.parent.name != "kernels"} == {}


def test_no_module_knows_all_of_its_folder():
    wrong = {}
    for path in modules():
        name = name_of(path)
        own = [other for other in imports(path) if other.rpartition(".")[0] == name.rpartition(".")[0]]
        if len(own) > MOST_OF_OWN_FOLDER and path.name != "__init__.py":
            wrong[name] = len(own)
    assert wrong == {}


def importers():
    found = defaultdict(set)
    for path in modules():
        for target in imports(path):
            found[target].add(name_of(path))
    return found


def lonely():
    """Short modules that one other imports, and nobody else."""
    known = importers()
    return [
        name_of(path)
        for path in modules()
        if path.name not in ("__init__.py", "__main__.py")
        and len(path.read_text().splitlines()) < SHORT
        and not name_of(path).startswith(OF_THEIR_OWN)
        and len(known[name_of(path)]) < 2
    ]


def test_short_modules_have_two_importers():
    assert lonely() == []


# ---------------------------------------------------------------- the filter owns its state
OWNED = {"P", "nav", "x"}


def writes(tree):
    """Where state or covariance of a filter are written: elements of them, or of a name that was given to them."""
    found = []
    for function in [n for n in ast.walk(tree) if isinstance(n, ast.FunctionDef)]:
        alias = set()
        for node in ast.walk(function):
            if isinstance(node, ast.Assign):
                for target, value in pairs(node):
                    owned = isinstance(value, ast.Attribute) and value.attr in OWNED and of_filter(value.value)
                    if isinstance(target, ast.Name) and owned:
                        alias.add(target.id)
        for node in ast.walk(function):
            targets = node.targets if isinstance(node, ast.Assign) else [getattr(node, "target", None)]
            if not isinstance(node, ast.Assign | ast.AugAssign):
                continue
            for target in [
                part for t in targets for part in ast.walk(t) if isinstance(getattr(part, "ctx", None), ast.Store)
            ]:
                base = target.value if isinstance(target, ast.Subscript) else target
                direct = isinstance(base, ast.Attribute) and base.attr in OWNED and of_filter(base.value)
                in_place = isinstance(target, ast.Subscript) or isinstance(node, ast.AugAssign)
                if direct or (isinstance(base, ast.Name) and base.id in alias and in_place):
                    found.append(f"{node.lineno}: {ast.unparse(node)[:60]}")
    return found


def pairs(node):
    for target in node.targets:
        if (
            isinstance(target, ast.Tuple)
            and isinstance(node.value, ast.Tuple)
            and len(target.elts) == len(node.value.elts)
        ):
            yield from zip(target.elts, node.value.elts, strict=True)
        else:
            yield target, node.value


def of_filter(node):
    """Whether an object is a filter or its memory, by its name."""
    return ast.unparse(node).split(".")[-1] in ("memory", "filter", "run", "nav", "source", "target")


def test_the_filter_alone_writes_its_state():
    found = {name_of(path): writes(tree_of(path)) for path in modules() if name_of(path) != "filter.filter"}
    assert {name: places for name, places in found.items() if places} == {}


def test_the_search_for_writes_finds_them():
    text = "def f(filter):\n    P = filter.memory.P\n    P[0, 0] += 1.0\n    filter.memory.x[1] = 2.0\n"
    assert len(writes(ast.parse(text))) == 2


def takers():
    """Functions outside the class that take a whole `Filter`."""
    return [
        f"{name_of(path)}.{node.name}"
        for path in modules()
        for node in ast.walk(tree_of(path))
        if isinstance(node, ast.FunctionDef)
        for arg in (*node.args.args, *node.args.kwonlyargs)
        if arg.annotation is not None and ast.unparse(arg.annotation) == "Filter"
    ]


def test_hardly_anybody_takes_a_whole_filter():
    found = set(takers())
    assert len(found) <= 5 and all(name.startswith("navigation.") for name in found), found


def test_public_names_occur_once_in_a_layer():
    known = defaultdict(set)
    for path in modules():
        for node in tree_of(path).body:
            public = isinstance(node, ast.FunctionDef | ast.ClassDef) and not node.name.startswith("_")
            if public and not name_of(path).startswith(FACES):
                known[room(name_of(path)), node.name].add(name_of(path))
    assert {f"{place}: {name}": sorted(where) for (place, name), where in known.items() if len(where) > 1} == {}


#: Each file of these answers to the same few names: formats, sub-commands.
FACES = ("io.logs", "io.tracks", "commands")


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
        [node for path in modules() for node in ast.walk(tree_of(path)) if isinstance(node, ast.ClassDef)],
    )
    while (
        new := {node.name for node in tree if found & {ast.unparse(b).rsplit(".", 1)[-1] for b in node.bases}} - found
    ):
        found |= new
    return found - {base}


def names_in(node):
    return {getattr(part, "attr", getattr(part, "id", None)) for part in ast.walk(node)}


#: Where each family of kinds is at home.
HOMES = {"Sensor": "models.sensors", "Mechanisation": "models.mechanisation"}
#: What may ask for one drive: the simulator draws an inertial unit's triples, learning at rest is about nothing else.
EXCEPTIONS = {
    ("simulation.simulate", "Imu"),
    ("learning.static_recorder", "Imu"),
    ("io.vehicle_toml", "DeadReckoningLane"),
}


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
        if name.startswith(HOMES[base]):
            continue
        for node in ast.walk(tree_of(path)):
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
        for node in tree_of(path).body:
            value = getattr(node, "value", None) if isinstance(node, ast.Assign | ast.AnnAssign) else None
            if value is None or name.startswith(tuple(HOMES.values())):
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
    parts = {"Filter", "LearningSchedule", "Navigator", "History", "ImuIntake", "Channel", "Listener", "RestRecorder"}
    assert {name: found for name, found in bases.items() if parts & set(found)} == {}


#: Names with an underscore that other libraries mean to be used: named tuples, what a kernel is built of, a time stamp.
OPEN = {
    *("context.active_code_library._reload_init", "state.library._reload_init", "state.library._final_module"),
    *("view._getvalue", "colours._markup"),
    "kept._source_stamp",  # numba's: which files a kept kernel depends on
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


if __name__ == "__main__":
    files = {name_of(path): len(imports(path)) for path in modules()}
    print(f"{len(arrows())} rooms on {max(map(floor, arrows()))} floors, {sum(map(len, arrows().values()))} arrows")
    print(f"{len(files)} files, {sum(files.values())} imports, circles: {circles() or 'none'}")
    print(f"{sum(code_lines(path) for path in modules())} lines of code")
    print(f"functions that take a Filter: {sorted(set(takers()))}", file=sys.stdout)
    print(f"short modules with one importer: {lonely()}")
