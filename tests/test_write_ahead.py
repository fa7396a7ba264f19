"""What is published is in the log first, or says that it is ahead of it; however slow the disk is."""

import json
import os
import threading

import numpy as np
import pytest
from live_run import Dive, Process, states, wait_for

from navfilter.io.json_lines import LineParser
from navfilter.service.disk import Disk
from navfilter.service.log import LOG_FILE
from navfilter.service.output import Outlet
from navfilter.service.session import Session


@pytest.fixture
def ours():
    reading, writing = os.pipe()
    with os.fdopen(reading, "rb") as reader:
        yield reader, writing
        os.close(writing)


def test_a_sync_that_hangs_holds_up_neither_log_nor_states(tmp_path, monkeypatch, ours):
    reader, writing = ours
    synced, path = threading.Event(), tmp_path / "log"
    monkeypatch.setattr(os, "fsync", lambda handle: synced.wait())
    disk, outlet = (
        Disk(path.open("ab", buffering=0), tmp_path / "state", 0.0, lambda *told, **fields: None),
        Outlet(writing),
    )
    monkeypatch.setattr(Outlet, "HOLD_S", 1e3)  # so a state that waits for the sync is never seen
    outlet.follow(disk.behind)
    for k in range(3):
        disk.append(b'{"k":%d}\n' % k)
        disk.snapshot(b"{}\n", b"")
        outlet.put(b'{"state":%d}\n' % k, True, disk.appended)
        assert reader.readline() == b'{"state":%d}\n' % k
        assert path.read_bytes().count(b"\n") == k + 1
    synced.set()
    assert disk.close() and outlet.close()


def test_a_state_whose_reading_is_not_written_says_so(tmp_path, monkeypatch, ours):
    reader, writing = ours
    monkeypatch.setattr(Outlet, "HOLD_S", 0.01)
    disk, outlet = (
        Disk(os.fdopen(os.open(tmp_path / "log", os.O_CREAT | os.O_RDWR), "ab", buffering=0), None, 1.0, None),
        Outlet(writing),
    )
    outlet.follow(disk.behind)
    with disk._file_lock:  # as long as a write takes
        disk.append(b"1\n2\n3\n")
        outlet.put(b'{"state":1}\n', True, disk.appended)
        outlet.put(b'{"notice":1}\n', False)
        assert [json.loads(reader.readline()) for _ in range(2)] == [{"state": 1, "ahead_of_log": 3}, {"notice": 1}]
    assert disk.behind(3, 1e3) == 0
    outlet.put(b'{"state":2}\n', True, disk.appended)
    assert reader.readline() == b'{"state":2}\n'
    assert disk.close() and outlet.close()


def test_what_does_not_fit_in_the_queue_is_told_before_the_state(tmp_path, monkeypatch):
    told = []
    monkeypatch.setattr(Disk, "LONGEST_QUEUE", 4)
    disk = Disk(
        (tmp_path / "log").open("ab", buffering=0),
        None,
        1.0,
        lambda what, **fields: told.append((what, fields["lost_lines"])),
    )
    with disk._file_lock:
        disk.append(b"1\n")
        wait_for(lambda: not disk._queue)  # it is being written
        for lines in (b"2\n3\n", b"4\n", b"5\n6\n"):
            disk.append(lines)
        assert (told, disk.behind(6, 0.0)) == ([("disk-failed", 1)], 6)
    assert disk.behind(6, 1e3) == 0 and disk.close()
    assert (tmp_path / "log").read_bytes() == b"1\n2\n3\n" and disk.lost_lines == 3


SLOW = "import os, time\nfsync = os.fsync\nos.fsync = lambda handle: (time.sleep(1.0), fsync(handle))[1]\n"


@pytest.mark.slow
def test_two_hundred_kills_on_a_slow_disk(tmp_path):
    """Each run goes on where the one before was killed; whatever a state was published from is in the log."""
    dive, folder, rng = Dive(tmp_path, "lawnmower", 450.0), tmp_path / "log", np.random.default_rng(51)
    (tmp_path / "sitecustomize.py").write_text(SLOW)
    paths = os.pathsep.join(filter(None, [str(tmp_path), os.getcwd(), os.environ.get("PYTHONPATH")]))
    arguments = [*dive.arguments, "--log", folder, "--resume", "--snapshot-every", "0.2", "--fsync", "0.1", "--quiet"]
    times, rests_on = [json.loads(line)["time_s"] for line in dive.lines], {}
    # how many readings a state rests on: those of its own stamp may come behind it
    fed, parser = 0, LineParser(dive.vehicle)
    session = Session(dive.vehicle, dive.options, lambda line, is_state: rests_on.setdefault(line, fed))
    for line in dive.lines:
        fed += 1
        session.feed(parser.parse(line))
    sent = 0
    for _ in range(200):
        process = Process(*arguments, env={**os.environ, "PYTHONPATH": paths})
        next_s = float(np.floor(times[sent])) + 1.0
        begin, end = np.searchsorted(times, [next_s + 0.1, next_s + 1.1]).tolist()
        process.send(dive.lines[sent:begin])
        process.read_until(next_s)
        killing = threading.Timer(rng.uniform(0.0, 0.5), process.process.kill)
        killing.start()
        quietly(process, dive.lines[begin:end], float(rng.uniform(0.0, 0.02)))
        killing.join()
        process.end()
        output = [line for line in process.output if b'"event"' not in line]
        assert {line for line in output if b"ahead_of_log" not in line} <= rests_on.keys()
        logged = [line for line in (folder / LOG_FILE).read_bytes().splitlines(True) if line.startswith(b'{"sensor"')]
        sent = len(logged)
        assert logged == dive.lines[:sent]
        assert b"ahead_of_log" in output[-1] or sent >= rests_on[output[-1]]
    process = Process(*arguments)
    process.send(dive.lines[sent:])
    assert states(process.end())[0][-1] == states(dive.output)[0][-1]


def quietly(process, lines, pause_s):
    try:
        for k in range(0, len(lines), 20):
            process.send(lines[k : k + 20])
            threading.Event().wait(pause_s)
    except OSError:
        pass
