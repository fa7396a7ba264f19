"""Shared fixtures."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import settings

RECORDINGS = Path(__file__).parent / "recordings"

# The same examples in every run and on every machine. Random search is asked for (see benchmarks/fuzz.py); what it finds
# becomes an example.
settings.register_profile("fixed", derandomize=True, database=None, deadline=None)
settings.register_profile("search", derandomize=False, database=None, deadline=None)
settings.load_profile("fixed")


def pytest_configure(config: pytest.Config) -> None:
    """Compile, where nothing is compiled yet, once and not in every process of pytest-xdist at the same time."""
    if not hasattr(config, "workerinput") and getattr(config.option, "numprocesses", None):
        from navfilter.commands.console import compile_first

        compile_first(quiet=False)


@pytest.fixture
def recording() -> Callable[[str], Path]:
    """Folder of the mission.toml of a recording, as ``recording("snapir-auv-1hz/01")``.

    Skips where NAVFILTER_DATA is unset; where it is set, data that are missing are a failure.
    """

    def folder(name: str) -> Path:
        root = os.environ.get("NAVFILTER_DATA")
        if not root:
            pytest.skip("set NAVFILTER_DATA to the folder of the recordings to run this test")
        assert Path(root).is_dir(), f"NAVFILTER_DATA is {root}, but there is no such folder"
        assert (RECORDINGS / name / "mission.toml").exists(), f"no mission.toml for {name}"
        return RECORDINGS / name

    return folder
