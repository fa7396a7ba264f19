"""Constants of the fault rules stand in one file, each with unit and origin; chosen ones only become fewer."""

import ast
import re
from pathlib import Path

import navfilter.faults
from navfilter.faults import settings

FOLDER = Path(navfilter.faults.__file__).parent
#: Groups of constants that were chosen by judgement when they were counted last. It may fall.
MOST_CHOSEN = 57


def described():
    """Name(s) of each constant with the comment above it."""
    text = Path(settings.__file__).read_text()
    lines = text.splitlines()
    for node in ast.parse(text).body:
        if isinstance(node, ast.Assign):
            at = node.lineno - 1
            above = []
            while lines[at - 1].startswith("#:"):
                at -= 1
                above.insert(0, lines[at][2:].strip())
            yield ast.unparse(node.targets[0]), " ".join(above)


def test_every_constant_has_a_unit_and_an_origin():
    wrong = [
        name
        for name, text in described()
        if not re.search(r"\((derived|measured|chosen)\)$", text) or not re.search(r"\[[^\]]+\]", text)
    ]
    assert wrong == []


def test_constants_that_were_chosen_only_become_fewer():
    assert sum(text.endswith("(chosen)") for _, text in described()) <= MOST_CHOSEN


def test_no_rule_has_a_constant_of_its_own():
    found = []
    for path in FOLDER.rglob("*.py"):
        if path.name == "settings.py":
            continue
        for node in ast.parse(path.read_text()).body:
            if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name) and node.targets[0].id.isupper():
                value = node.value
                if isinstance(value, ast.Constant) and isinstance(value.value, float):
                    found.append(f"{path.relative_to(FOLDER)}: {node.targets[0].id} = {value.value}")
    assert set(found) <= {
        "sensor_bias.py: GRAVITY = 9.81",  # of nature
        "lane_selection.py: LARGE = 1400.0",  # of the arithmetic
        "sensor_bias.py: SAME_S = 1e-06",
        "imu/monitor.py: RANGE_END = 0.999",
    }
