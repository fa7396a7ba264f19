"""Shared fixtures."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import pytest

RECORDINGS = Path(__file__).parent / "recordings"


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


@pytest.fixture
def log_sample() -> Callable[[str], Path]:
    """A small real log of another maker's format, as ``log_sample("px4/sample_log_small.ulg")``; skips as `recording`."""

    def file(name: str) -> Path:
        root = os.environ.get("NAVFILTER_DATA")
        if not root:
            pytest.skip("set NAVFILTER_DATA to the folder of the recordings to run this test")
        path = Path(root) / "logs" / name
        assert path.exists(), f"NAVFILTER_DATA is {root}, but there is no {path}"
        return path

    return file
