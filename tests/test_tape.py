"""The spool of a tape."""

from __future__ import annotations

import gc
import warnings

import numpy as np

from navfilter.filter.tape import Spool


def test_a_spool_that_nobody_holds_closes_its_file(monkeypatch):
    """Also where it is part of a circle, as the tape of a navigator is."""
    monkeypatch.setattr(Spool, "CHUNK", 1 << 8)
    unclosed = []
    monkeypatch.setattr("sys.unraisablehook", unclosed.append)
    spool = Spool(0)
    for k in range(40):
        spool.new(100)[:] = k
    assert spool[0][0] == 0.0 and np.all(spool[39] == 39.0)
    file = spool._file
    circle = [spool]
    circle.append(circle)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        del spool, circle
        gc.collect()
    assert file.closed and not unclosed
