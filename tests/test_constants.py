"""Numbers of the learning path stand once: two modules that define the same name would drift apart."""

import ast
from collections import defaultdict
from pathlib import Path

import numpy as np
import pytest

import navfilter
from navfilter.learning.settings import OptimiserSettings
from navfilter.timeseries.order_criterion import CRITERIA, Challenge, Choice, criterion

ROOT = Path(navfilter.__file__).parent


def constants(path):
    """Upper-case names that a module assigns at its top level."""
    for node in ast.parse(path.read_text()).body:
        targets = (
            node.targets if isinstance(node, ast.Assign) else [node.target] if isinstance(node, ast.AnnAssign) else []
        )
        yield from (
            name.id
            for target in targets
            for name in ast.walk(target)
            if isinstance(name, ast.Name) and name.id.isupper()
        )


def test_no_constant_of_the_learning_path_is_defined_twice():
    places = defaultdict(list)
    for folder in ("arma", "learning"):
        for path in sorted((ROOT / folder).rglob("*.py")):
            for name in constants(path):
                places[name].append(str(path.relative_to(ROOT)))
    assert len(places) > 20
    assert {name: where for name, where in places.items() if len(where) > 1} == {}


def test_every_field_of_the_effort_is_explained():
    described = OptimiserSettings.__doc__
    assert [name for name in OptimiserSettings.__dataclass_fields__ if name not in described] == []


def test_every_field_of_the_effort_is_used():
    used = "".join(path.read_text() for path in (ROOT / "learning").glob("*.py"))
    assert [name for name in OptimiserSettings.__dataclass_fields__ if f"EFFORT.{name}" not in used] == []


@pytest.mark.parametrize("name", CRITERIA)
def test_a_parameter_that_gains_nothing_makes_every_criterion_worse(name):
    values = [criterion(name, 1000.0, k, 400) for k in range(6)]
    assert np.all(np.diff(values) > 0.0)


def test_bic_is_that_of_schwarz():
    # exact: the same two operations
    assert Choice("bic").score(-12.5, 3, 1000) == -12.5 + 3 * np.log(1000)


def test_a_challenge_counts_hops_in_a_row_of_the_same_order():
    challenge = Challenge().by((1, 0)).by((1, 0))
    assert challenge == Challenge((1, 0), 2)
    assert challenge.by((2, 1)) == Challenge((2, 1), 1)
