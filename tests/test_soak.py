"""Hours with a fault every few minutes: memory flat, state consistent. The whole day is ``benchmarks/soak.py``."""

import sys
from pathlib import Path

import pytest

BENCHMARKS = Path(__file__).parent.parent / "benchmarks"


@pytest.fixture
def soak(monkeypatch):
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    import soak

    yield soak
    sys.modules.pop("soak", None)


def test_minutes_with_every_fault(soak, monkeypatch):
    monkeypatch.setattr(soak, "EVERY_S", 20.0)
    monkeypatch.setattr(soak, "AT_S", 8.0)
    monkeypatch.setattr(soak, "FAULTS", {name: min(span, 8.0) for name, span in soak.FAULTS.items()})
    found = soak.soaked(300.0 / 3600.0, seed=2, rate_hz=10, show=False)
    assert set(found.faults) - {""} == set(soak.FAULTS) and found.finite and found.smallest > soak.DEFINITE
    # the beginning is kept to be run again until 1000 s: 3.3 kB a second
    assert found.rows[-1]["snapshot_kb"] < 5.0 * 300.0


@pytest.mark.slow
def test_three_hours_stay_flat(soak):
    found = soak.soaked(3.0, seed=2, rate_hz=10, show=False)
    assert not found.failures and found.faults.total() >= 15
