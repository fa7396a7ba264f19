"""The spool of a tape."""

from __future__ import annotations

import gc
import warnings

import numpy as np

from navfilter.filter.records import RecordStore


def test_a_spool_that_nobody_holds_closes_its_file(monkeypatch):
    """Also where it is part of a circle, as the tape of a navigator is."""
    monkeypatch.setattr(RecordStore, "CHUNK", 1 << 8)
    unclosed = []
    monkeypatch.setattr("sys.unraisablehook", unclosed.append)
    spool = RecordStore(0)
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


def test_a_spool_holds_what_a_list_would(monkeypatch):
    """Whatever is appended, alone or many at once, and dropped again; its chunks go to the file and are used again."""
    monkeypatch.setattr(RecordStore, "CHUNK", 1 << 6)
    rng = np.random.default_rng(3)
    spool, kept = RecordStore(0), []
    for k in range(400):
        what = rng.integers(4)
        if what == 0 and kept:
            spool.drop()
            kept.pop()
        elif what == 1:
            kept.append(np.full(rng.integers(1, 90), float(k)))
            spool.new(kept[-1].size)[:] = kept[-1]
        else:
            some = [np.full(size, k + 0.1 * i) for i, size in enumerate(rng.integers(0, 40, rng.integers(0, 6)))]
            spool.extend(np.concatenate([np.empty(0), *some]), np.array([len(each) for each in some], np.int64))
            kept += some
        if kept:
            np.testing.assert_array_equal(spool[-1], kept[-1])
    assert len(spool) == len(kept) and sum(chunk is None for chunk in spool._chunks) > 50
    for k in rng.permutation(len(kept)).tolist():
        np.testing.assert_array_equal(spool[k], kept[k])
    copy, most = RecordStore(1 << 20), len(kept) // 2
    for flat, sizes in spool.pieces(most):
        copy.extend(flat, sizes)
    assert len(copy) == most and all((copy[k] == kept[k]).all() for k in range(most))
    first, last = 7, len(kept)
    while last > first:
        flat, begins = spool.run(first, last)
        for begin, vector in zip(begins, kept[last - len(begins) : last], strict=True):
            np.testing.assert_array_equal(flat[begin : begin + len(vector)], vector)
        last -= len(begins)
    assert last == first


def test_memory_is_used_again_but_not_while_somebody_looks_at_it(monkeypatch):
    """A spool leaves its blocks to the next one; those that are still seen stay as they are."""
    monkeypatch.setattr("navfilter.filter.records._idle", [])
    first, second = RecordStore(1 << 30), RecordStore(1 << 30)
    first.new(3)[:] = 1.0
    second.new(3)[:] = 2.0
    address, view = first[0].ctypes.data, second[0]
    del first, second
    third, fourth = RecordStore(1 << 30), RecordStore(1 << 30)
    third.new(3)[:] = 3.0
    fourth.new(3)[:] = 4.0
    assert third[0].ctypes.data == address and np.all(view == 2.0)
    assert np.all(third[0] == 3.0) and np.all(fourth[0] == 4.0)


def test_a_spool_that_goes_to_its_file_leaves_nothing_behind(monkeypatch):
    """Early, because the tape is that of a long run, or with more than is to be in memory: its blocks are given up."""
    monkeypatch.setattr("navfilter.filter.records._idle", idle := [])
    for early in (True, False):
        spool = RecordStore((1 << 30) if early else 5 * 8 * RecordStore.CHUNK)
        vectors = 40 if early else 70
        for k in range(vectors):
            spool.new(RecordStore.CHUNK // 10)[:] = k
            if early and k == 35:
                spool.to_file()
        assert spool.in_file and not idle and sum(chunk is not None for chunk in spool._chunks) <= 2
        assert all(np.all(spool[k] == k) for k in range(vectors))
