"""The manual is complete and true to the code: every key, every public name, every module, every link."""

import dataclasses
import re
import tomllib
from pathlib import Path

import pytest

import navfilter
from navfilter.io import mission_schema as schema
from navfilter.io.mission_schema import FORMS, TRUTH_ONLY, groups
from navfilter.io.table import Where
from navfilter.io.tracks.formats import FORMATS
from navfilter.io.units import ALIASES, SUFFIXES, UNITS
from navfilter.io.vehicle_toml import plain_key, times
from navfilter.models.error_models import Arma, GaussMarkov, RandomWalk, White
from navfilter.models.learned_arma import LearnedArma
from navfilter.models.mechanisation import DeadReckoning, Imu, Mechanisation
from navfilter.models.sensors import (
    Altitude,
    Attitude,
    BodyVelocity,
    Course,
    Depth,
    DvlBeams,
    Heading,
    Odometer,
    Position,
    Range,
    Sensor,
    Usbl,
    WaterVelocity,
    ZeroVelocity,
)
from navfilter.models.sensors.traits import kinds_below
from navfilter.models.vehicle import Vehicle
from navfilter.timeseries.model import ArmaModel

ROOT = Path(__file__).parent.parent
MANUAL = ROOT / "docs" / "pages"
PAGES = [ROOT / "README.md", ROOT / "CHANGELOG.md", *sorted(MANUAL.rglob("*.md"))]
WIDTH = 120


def text_of(page):
    return (MANUAL / page).read_text(encoding="utf-8")


def section(page, heading):
    """The text below a heading, up to the next one of any depth."""
    _, below = re.split(rf"^#+ {re.escape(heading)}$", text_of(page), maxsplit=1, flags=re.MULTILINE)
    return re.split(r"^#+ ", below, maxsplit=1, flags=re.MULTILINE)[0]


def keys(page, heading):
    """First and second cell of the last table below a heading, where the first is one key: ``{key: default}``."""
    rows = re.findall(r"^\| `(\w+)`[^|]* \| (.*?) \|", section(page, heading), flags=re.MULTILINE)
    assert rows and len(dict(rows)) == len(rows), heading
    return dict(rows)


def stated(cell):
    """The default that a cell states, ``None`` where it says it in words."""
    found = re.fullmatch(r"`([^`]+)`", cell)
    return None if found is None else tomllib.loads(f"x = {found.group(1)}")["x"]


def listed(value):
    return list(value) if isinstance(value, tuple) else value


# --- keys of mission.toml -------------------------------------------------------------------------------------------

#: Groups of columns that the package's own kinds read; other tests define kinds of their own.
OWN = [
    kind for base in (Mechanisation, Sensor) for kind in kinds_below(base) if kind.__module__.startswith("navfilter.")
]
READ = {c.group for kind in OWN for c in (*(column for must in kind.contents for column in must), *kind.beside)}
READ |= {form.group for name, forms in FORMS.items() if name in READ for form in forms} | {c.group for c in TRUTH_ONLY}
GROUP_NAMES = {*READ, "series", "sd"}
MISSION_TABLES = {
    "The mission": (schema.MissionSpec, set()),
    "Stream": (schema.StreamSpec, set()),
    "Source": (schema.Source, GROUP_NAMES),
    "Where": (Where, set()),
    "Time": (schema.Clock, set()),
    "Component": (schema.Component, set()),
    "Origin": (schema.Origin, set()),
    "Start": (schema.StartSpec, set()),
    "During": (schema.DuringSpec, set()),
    "Log": (schema.LogSpec, set()),
}


def fields_of(model):
    return {field.alias or name: field for name, field in model.model_fields.items()}


def assert_states(documented, fields):
    assert set(documented) == set(fields)
    for key, cell in documented.items():
        assert fields[key].is_required() == (cell == "must be there"), key
        if (default := stated(cell)) is not None:
            assert default == listed(fields[key].get_default(call_default_factory=True)), key


@pytest.mark.parametrize("heading", MISSION_TABLES)
def test_every_key_of_mission_toml_is_described(heading):
    model, elsewhere = MISSION_TABLES[heading]
    assert_states(
        keys("mission-toml.md", heading),
        {key: field for key, field in fields_of(model).items() if key not in elsewhere},
    )


def test_every_group_of_mission_toml_and_its_keys_are_described():
    listed, own = section("mission-toml.md", "Groups").split("Short forms")
    assert set(re.findall(r"^\| `(\w+)` \[", listed, flags=re.MULTILINE)) == GROUP_NAMES
    for name, sizes in re.findall(r"^\| `(\w+)` \[([^]]+)\]", listed, flags=re.MULTILINE):
        assert name in ("series", "sd") or sizes.endswith(str(len(groups()[name].names))), name
    assert_states(dict(re.findall(r"^\| `(\w+)` \| (.*?) \|", own, flags=re.MULTILINE)), fields_of(schema.Group))


def test_every_unit_is_listed():
    rows = re.findall(r"^\| (.+?) \| (`.*) \|$", section("mission-toml.md", "Units"), flags=re.MULTILINE)
    assert {(unit, dimension) for dimension, units in rows for unit in re.findall(r"`([^`]+)`", units)} == {
        (name, unit.dimension) for name, unit in UNITS.items() if name
    }
    others = section("mission-toml.md", "Units").split("Other names for the same:")[1].split("Anything else")[0]
    assert re.findall(r"`([^`]+)`", others) == list(ALIASES)
    endings = section("vehicle-toml.md", "Units").split("These endings are known:")[1]
    assert re.findall(r"`([^`]+)`", endings) == list(SUFFIXES)


# --- keys of vehicle.toml -------------------------------------------------------------------------------------------

VEHICLE_TABLES = {
    "model: white": White,
    "model: random-walk": RandomWalk,
    "model: gauss-markov": GaussMarkov,
    "model: arma": Arma,
    "model: learned-arma": LearnedArma,
    "drive: imu": Imu,
    "drive: dead-reckoning": DeadReckoning,
    "All sensors": Sensor,
    "type: body-velocity": BodyVelocity,
    "type: odometer": Odometer,
    "type: course": Course,
    "type: water-velocity": WaterVelocity,
    "type: dvl-beams": DvlBeams,
    "type: heading": Heading,
    "type: attitude": Attitude,
    "type: depth": Depth,
    "type: altitude": Altitude,
    "type: position": Position,
    "type: range": Range,
    "type: usbl": Usbl,
    "type: zero-velocity": ZeroVelocity,
}


def own_fields(cls):
    """The fields that the table of a class describes: of a sensor those that differ from its parent's."""
    fields = {field.name: field for field in dataclasses.fields(cls) if field.init}
    above = (
        {field.name: field for field in dataclasses.fields(cls.__base__)}
        if issubclass(cls, Sensor) and cls is not Sensor
        else {}
    )
    return {name: field for name, field in fields.items() if name not in above or above[name].default != field.default}


@pytest.mark.parametrize("heading", VEHICLE_TABLES)
def test_every_key_of_vehicle_toml_is_described(heading):
    cls = VEHICLE_TABLES[heading]
    fields = own_fields(cls)
    if cls is LearnedArma:
        fields["adopted"] = fields.pop("model")
        del fields["spectrum"], fields["level"]  # for reports, and of the moment: not in files
    documented = {plain_key(key, fields): cell for key, cell in keys("vehicle-toml.md", heading).items()}
    assert {name for name, _ in documented} == set(fields)
    for (name, factor), cell in documented.items():
        default = fields[name].default
        assert (default is dataclasses.MISSING) == (cell == "must be there"), name
        if (value := stated(cell)) is not None:
            assert (value if factor is None else times(value, factor)) == listed(default), name


def test_every_kind_of_vehicle_toml_is_described():
    """Also those that a newer class brings."""
    from navfilter.io.vehicle_toml import _ADOPTED, _concrete, _kinds
    from navfilter.models.mechanisation import Mechanisation

    def own(base):
        found = _concrete(base, _kinds())
        return {kind for kind, cls in found.items() if cls.__module__.startswith("navfilter")}

    headings = set(re.findall(r"^### (\w+: [\w-]+)$", text_of("vehicle-toml.md"), flags=re.MULTILINE))
    kinds = {f"model: {kind}" for kind in own(navfilter.ErrorModel)} | {f"drive: {kind}" for kind in own(Mechanisation)}
    assert headings == kinds | {f"type: {kind}" for kind in own(Sensor)}
    assert set(keys("vehicle-toml.md", "adopted")) == set(_ADOPTED) <= set(ArmaModel.__dataclass_fields__)
    assert set(keys("vehicle-toml.md", "The vehicle")) == {field.name for field in dataclasses.fields(Vehicle)}


# --- formats of tracks ----------------------------------------------------------------------------------------------


def test_the_table_of_formats_is_that_of_the_program():
    rows = re.findall(
        r"^\| `track(\.\w+)` \| (\S+) \|.*\| ([^|]*?) ?\| ([^|]*?) ?\|$", text_of("outputs.md"), flags=re.M
    )
    assert len(rows) == len(FORMATS)
    for form, (suffix, option, without_utc, needs) in zip(FORMATS, rows, strict=True):
        assert suffix == form.suffix
        assert option == ("always" if form.always else f"`--{form.name}`")
        assert (without_utc == "refused") == form.utc == ("UTC" in needs)
        assert ("a place" in needs) == form.place
        assert re.findall(r"navfilter\[(\w+)\]", needs) == [form.extra] * bool(form.extra)


# --- how it is built ------------------------------------------------------------------------------------------------

PACKAGE = ROOT / "navfilter"


def the_map():
    """Folders of the package that the map of "How it is built" names."""
    tree = re.search(r"^navfilter/\n(.*?)^tests/", section("how-it-is-built.md", "The rooms"), flags=re.M | re.S).group(
        1
    )
    return [re.findall(r"(\w+)/", re.split(r" {2,}", line.strip())[0]) for line in tree.splitlines()]


def test_the_map_has_every_room():
    there = {path.name for path in PACKAGE.iterdir() if (path / "__init__.py").exists()}
    rooms = [room for line in the_map() for room in line]
    assert set(rooms) == there and len(rooms) == len(there)


def test_the_map_has_the_order_of_the_house():
    """Its lines are the layers that the test of the house holds imports to."""
    from test_house import LAYERS

    floors = {room: i for i, rooms in enumerate(LAYERS) for room in rooms}
    lines = [{floors[room] for room in line} for line in the_map()]
    assert all(len(line) == 1 for line in lines) and lines == sorted(lines, key=min)


def test_who_acts_stands_in_the_file_that_is_named():
    """Each row of the way of a reading, and every other path of the page."""
    rows = re.findall(r"^\| `([\w/]+\.py)` \| `([\w.]+)` \|", text_of("how-it-is-built.md"), flags=re.MULTILINE)
    assert len(rows) > 8
    for path, who in rows:
        source = (PACKAGE / path).read_text(encoding="utf-8")
        for name in who.split("."):
            assert re.search(rf"^ *(class|def) {name}\b", source, flags=re.MULTILINE), f"{who} does not stand in {path}"
    named = set(
        re.findall(r"`((?:filter|faults|learning|navigation|kernels)/[\w/]+\.py)`", text_of("how-it-is-built.md"))
    )
    assert {path for path in named if not (PACKAGE / path).exists()} == set()


def test_the_lines_that_join_filter_and_learning_are_the_codes_own():
    shown = re.search(r"^```python\n(.*?)^```", text_of("how-it-is-built.md"), flags=re.M | re.S).group(1)
    lines = [
        line.strip() for line in (PACKAGE / "navigation" / "navigator.py").read_text(encoding="utf-8").splitlines()
    ]
    first, *rest = [line.strip() for line in shown.splitlines()]
    assert [first, *rest] in [lines[i : i + 1 + len(rest)] for i, line in enumerate(lines) if line == first]


def test_the_reference_has_every_public_name():
    shown = {
        path.rsplit(".", 1)[1]
        for page in MANUAL.glob("api/*.md")
        for path in re.findall(r"^::: navfilter\.(\S+)", page.read_text(), re.M)
    }
    assert {*navfilter.__all__, *navfilter.timeseries.__all__} - shown == set()


# --- pages ----------------------------------------------------------------------------------------------------------


def anchors(page):
    """Anchors of the headings of a page, as MkDocs and the usual viewers of repositories make them."""
    headings = re.findall(r"^#+ (.+)$", page.read_text(encoding="utf-8"), flags=re.MULTILINE)
    return {re.sub(r"[\s]+", "-", re.sub(r"[^\w\s-]", "", heading).strip().lower()) for heading in headings}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_every_link_leads_somewhere(page):
    text = re.sub(r"^```.*?^```", "", page.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)
    for target in re.findall(r"\]\(([^)\s]+)\)", text):
        path, _, anchor = target.partition("#")
        if path.startswith("https:"):
            continue
        there = (page.parent / path).resolve() if path else page
        assert there.exists(), target
        assert not anchor or anchor in anchors(there), target


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_prose_is_no_wider_than_the_screen(page):
    """Tables, code and pictures cannot be wrapped."""
    text = re.sub(r"^```.*?^```", "", page.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)
    assert [line for line in text.splitlines() if len(line) > WIDTH and not line.startswith(("|", "!["))] == []


def test_the_readme_stays_short():
    assert len((ROOT / "README.md").read_text(encoding="utf-8").splitlines()) <= 250
