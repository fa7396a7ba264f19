"""Shared fixtures."""

from __future__ import annotations

import gc
import os
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import settings
from tiers import listed

RECORDINGS = Path(__file__).parent / "recordings"

# The same examples in every run and on every machine. Random search is asked for (see benchmarks/fuzz.py); what it
# finds becomes an example.
settings.register_profile("fixed", derandomize=True, database=None, deadline=None)
settings.register_profile("search", derandomize=False, database=None, deadline=None)
settings.load_profile("fixed")


def pytest_configure(config: pytest.Config) -> None:
    """Compile, where nothing is compiled yet, once and not in every process of pytest-xdist at the same time."""
    # compiled kernels are many objects that live on: to look through them all the time takes a seventh of a run
    gc.set_threshold(50_000, 20, 100)
    if not hasattr(config, "workerinput") and getattr(config.option, "numprocesses", None):
        from navfilter.commands.console import compile_first

        compile_first(quiet=False)


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Tests that `tiers` lists are slow ones."""
    waiting = listed()
    for item in items:
        if item.nodeid.removeprefix("tests/") in waiting:
            item.add_marker(pytest.mark.slow)


def data_root() -> Path:
    """The folder of the recordings. Skips where NAVFILTER_DATA is unset; where it is set, missing data are failures."""
    root = os.environ.get("NAVFILTER_DATA")
    if not root:
        pytest.skip("set NAVFILTER_DATA to the folder of the recordings to run this test")
    assert Path(root).is_dir(), f"NAVFILTER_DATA is {root}, but there is no such folder"
    return Path(root)


@pytest.fixture
def data_file() -> Callable[[str], Path]:
    """A recorded file, as ``data_file("baro-static/ms5611_static_altitude_80hz.csv.xz")``."""

    def file(name: str) -> Path:
        path = data_root() / name
        assert path.exists(), f"NAVFILTER_DATA is {data_root()}, but there is no {name}"
        return path

    return file


@pytest.fixture
def recording() -> Callable[[str], Path]:
    """Folder of the mission.toml of a recording, as ``recording("snapir-auv-1hz/01")``."""

    def folder(name: str) -> Path:
        data_root()
        assert (RECORDINGS / name / "mission.toml").exists(), f"no mission.toml for {name}"
        return RECORDINGS / name

    return folder


@pytest.fixture
def log_sample() -> Callable[[str], Path]:
    """A small real log of another maker's format, as ``log_sample("px4/sample_log_small.ulg")``; skips as
    `recording`.
    """

    def file(name: str) -> Path:
        root = os.environ.get("NAVFILTER_DATA")
        if not root:
            pytest.skip("set NAVFILTER_DATA to the folder of the recordings to run this test")
        path = Path(root) / "logs" / name
        assert path.exists(), f"NAVFILTER_DATA is {root}, but there is no {path}"
        return path

    return file
