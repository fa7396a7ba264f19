"""README and manual stay short, and what they name of the package is there."""

import re
from pathlib import Path

import pytest
from test_doctests import leads_somewhere

from navfilter.faults.policy import REJECTED

ROOT = Path(__file__).parent.parent
README = ROOT / "README.md"
MANUAL = sorted((ROOT / "docs").rglob("*.md"))
HOW = ROOT / "docs" / "pages" / "how-it-is-built.md"
MOST_OF_README, MOST_OF_MANUAL, MOST_OF_HOW = 1500, 40_000, 1500


def words(*pages):
    """As ``wc -w`` counts them."""
    return sum(len(page.read_text(encoding="utf-8").split()) for page in pages)


def test_the_readme_is_short():
    assert words(README) <= MOST_OF_README


def test_the_manual_is_short():
    assert words(*MANUAL) <= MOST_OF_MANUAL


def test_how_it_is_built_is_short():
    assert words(HOW) <= MOST_OF_HOW


def named(page):
    """Dotted names that begin with the package, in prose and in code; files such as ``navfilter.service`` of systemd
    stand behind a slash.
    """
    return set(re.findall(r"(?<![/\w-])navfilter(?:\.[A-Za-z_]\w*)+", page.read_text(encoding="utf-8")))


@pytest.mark.parametrize("page", [README, *MANUAL], ids=lambda page: page.relative_to(ROOT).as_posix())
def test_names_of_the_package_resolve(page):
    assert [name for name in sorted(named(page)) if not leads_somewhere(name)] == []


def test_names_are_found():
    """A pattern that finds nothing would find nothing wrong."""
    assert len(set().union(*map(named, MANUAL))) > 20
    assert leads_somewhere("navfilter.faults.policy.REJECTED") and not leads_somewhere("navfilter.faults.policy.NONE")


def test_files_of_the_package_that_pages_name_exist():
    """``faults/policy.py`` of a room."""
    rooms = {path.name for path in (ROOT / "navfilter").iterdir() if (path / "__init__.py").exists()}
    paths = {
        path
        for page in (README, *MANUAL)
        for path in re.findall(r"`(?:navfilter/)?((?:\w+/)+\w+\.py)\b", page.read_text(encoding="utf-8"))
        if path.split("/")[0] in rooms
    }
    assert len(paths) > 20
    assert {path for path in paths if not (ROOT / "navfilter" / path).exists()} == set()


def test_the_rules_for_refused_readings_are_those_of_the_policy():
    section = HOW.read_text(encoding="utf-8").split("\n## A refused reading")[1].split("\n## ")[0]
    assert re.findall(r"^\| `(_\w+)` \|", section, flags=re.MULTILINE) == [rule.__name__ for rule in REJECTED]
