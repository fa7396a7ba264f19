"""Numbers as text: the kernel writes what Python's ``%`` does, to the last character."""

from __future__ import annotations

import numpy as np
import pytest
from kernel_inputs import run_both

import navfilter as nf
from navfilter.io.tracks import table
from navfilter.io.tracks.table import text_of_rows
from navfilter.kernels import number_text
from navfilter.simulation.scenarios import simulate_scenario


def hard_numbers(digits):
    """Of all sizes, at and beside powers of ten, ties, those that are rounded up by a digit, and no numbers."""
    rng = np.random.default_rng(abs(digits))
    tens = 10.0 ** np.arange(-30, 30)
    halves = (np.arange(500) + 0.5) * 10.0 ** -abs(digits)
    return np.concatenate(
        [
            np.frombuffer(rng.bytes(8 * 3000), np.float64),
            rng.normal(size=3000) * 10.0 ** rng.integers(-12, 16, 3000),
            np.round(rng.normal(size=1000), 3),
            [*tens, *-tens, *np.nextafter(tens, 0.0), *np.nextafter(tens, 1e300)],
            [*halves, *-halves, *(2.0 * np.arange(500) + 1.0) / 2.0**11],
            [9999999.5, 9999999.4999, 999999.95, 0.00099999999, 0.0000999999949, 123456.75, 2.5, 0.5, 1.5, 99.99999999],
            [0.0, -0.0, -1e-9, np.nan, np.inf, -np.inf, 1e15, 9e15, 1e16, 1e-320, -1e-300, 1e300, -1.7e308],
        ]
    )


@pytest.mark.parametrize("digits", [1, 3, 5, 6, 10, -1, -2, -5, -7, -9])
def test_the_kernel_writes_what_python_writes(digits):
    values = hard_numbers(digits)[:, None]
    found, expected = (text_of_rows(values, (digits,), compiled=how).split(b"\n") for how in (True, False))
    wrong = [(x, a, b) for x, a, b in zip(values[:, 0], found, expected, strict=False) if a != b]
    assert len(found) == len(expected) and wrong == []


def test_few_numbers_are_left_to_python():
    """Or nothing would be gained."""
    values, digits = np.random.default_rng(0).normal(size=20000), np.array([10, -7])
    out, marks = np.empty(values.size * number_text.WIDEST, np.uint8), np.zeros((10000, 0), np.uint8)
    given, left, done = np.zeros(0, np.uint8), 0, 0
    while done < values.size:
        done, _ = number_text.rows_of_text(values, digits, marks, given, done, out)
        left, given = left + (done < values.size), np.frombuffer(b"0.0", np.uint8).copy()
    assert left <= 5


def test_the_kernel_and_its_twin():
    rng = np.random.default_rng(2)
    values, digits = rng.normal(size=40), np.array([6, -7, 3, -5])
    for marks in (np.zeros((10, 0), np.uint8), rng.integers(65, 90, (10, 4)).astype(np.uint8)):
        given = np.frombuffer(b"1.25", np.uint8).copy()
        for arguments in ((values, digits, marks, given[:0], 0), (values, digits, marks, given, 5)):
            out = np.zeros(40 * number_text.WIDEST, np.uint8)
            ours, twins = run_both(number_text.rows_of_text, *arguments, out)
            assert ours[-1].tobytes().rstrip(b"\0") == twins[-1].tobytes().rstrip(b"\0") != b""


@pytest.mark.parametrize("epoch_utc_s", [None, 1.78e9])
def test_a_track_is_the_same_by_the_kernel(epoch_utc_s, tmp_path, monkeypatch):
    from dataclasses import replace

    vehicle, mission = simulate_scenario("lawnmower", seed=1, duration_s=60.0)
    track = nf.replay(vehicle, replace(mission, epoch_utc_s=epoch_utc_s))
    table.write(track, tmp_path / "python.csv")
    assert len(track) * 50 < table.LONG
    monkeypatch.setattr(table, "LONG", 0)
    table.write(track, tmp_path / "kernel.csv")
    written = (tmp_path / "kernel.csv").read_bytes()
    assert written == (tmp_path / "python.csv").read_bytes() and written.count(b"\n") == len(track) + 1
    head, first = written.split(b"\n")[:2]
    assert len(head.split(b",")) == len(first.split(b",")) == len(track.to_frame().columns)
    assert (b"2026-05-28T" in first) == (epoch_utc_s is not None)
