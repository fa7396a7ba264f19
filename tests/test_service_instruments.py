"""Instruments that `navfilter run` connects to: a Water Linked DVL, played by a server of our own that goes, comes
back, talks nonsense, is slow, or says nothing.
"""

import contextlib
import json
import math
import signal
import socket
import threading

import numpy as np
import pytest
from live_run import Dive, Process, states, wait_for

import navfilter as nf
from navfilter.commands.cli import main
from navfilter.io.json_lines import LineParser, Reading
from navfilter.service.log import LOG_FILE
from navfilter.service.sources import PORT, Instrument, WaterLinked, waterlinked

VEHICLE = nf.Vehicle(imu=nf.Imu(rate_hz=100), sensors={"dvl": nf.BodyVelocity(), "water": nf.WaterVelocity()})


def report(time_s, value=(0.5, -0.1, 0.02), valid=True, **others):
    """A report as the instrument's manual has it, valid at a time and sent 0.15 s later."""
    fields = dict(zip(("vx", "vy", "vz"), value, strict=True)) | {"velocity_valid": valid, "type": "velocity"}
    stamps = {"time_of_validity": round(1e6 * time_s), "time_of_transmission": round(1e6 * (time_s + 0.15))}
    return json.dumps({"time": 100.0, "fom": 0.002, "format": "json_v3.1", **fields, **stamps, **others}).encode()


class Server:
    """One that listens where the instrument would, and does with each client what it is told."""

    def __init__(self):
        self.socket = socket.create_server(("127.0.0.1", 0))
        self.port = self.socket.getsockname()[1]
        self.url = f"waterlinked://127.0.0.1:{self.port}"

    def accept(self):
        self.socket.settimeout(60.0)
        return self.socket.accept()[0]

    def accept_nobody(self):
        """Keep the port, so that no connection to it gets it for its own end, and do not listen."""
        self.socket.close()
        self.socket = socket.socket()
        self.socket.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        self.socket.bind(("127.0.0.1", self.port))

    def close(self):
        self.socket.close()


@pytest.fixture
def server():
    with contextlib.closing(Server()) as one:
        yield one


@pytest.fixture
def instrument(server, monkeypatch):
    """An instrument at the server, as lists of what it hands over."""
    monkeypatch.setattr(Instrument, "AGAIN_S", 0.01)
    monkeypatch.setattr(Instrument, "LOOK_S", 0.01)
    one = Instrument(waterlinked(f"{server.url}?clock=instrument", VEHICLE), lambda: None)
    one.readings, one.told = [], []
    one.start()
    yield one
    one.close()


def taken(instrument, readings=0, told=""):
    """Take until so many readings came, and something with that word was told."""

    def happened():
        more, texts = instrument.take()
        instrument.readings += more
        instrument.told += texts
        return len(instrument.readings) >= readings and any(told in text for text in instrument.told or [""])

    wait_for(happened)


def parsed(lines):
    items = [LineParser(VEHICLE).parse(line) for line in lines]
    assert all(isinstance(item, Reading) for item in items)
    return items


# --- what is asked for ----------------------------------------------------------------------------------------------


def test_what_a_source_says():
    assert waterlinked("waterlinked://dvl.local", VEHICLE) == WaterLinked(
        "waterlinked://dvl.local", ("dvl.local", PORT), {"velocity": "dvl"}
    )
    reckoning = nf.Vehicle(nf.DeadReckoning(rate_hz=5), {})
    found = waterlinked(
        "waterlinked://10.0.0.5:99?velocity=velocity&position_local=attitude&clock=instrument", reckoning
    )
    assert found.address == ("10.0.0.5", 99) and found.own_clock
    assert found.sensors == {"velocity": "velocity", "position_local": "attitude"}


@pytest.mark.parametrize(
    ("url", "said"),
    [
        ("tcp://10.0.0.5:16171", "must look like waterlinked://"),
        ("waterlinked:///x", "must look like waterlinked://"),
        ("waterlinked://10.0.0.5:port", "Port could not be cast"),
        ("waterlinked://10.0.0.5:99999", "Port out of range"),
        ("waterlinked://10.0.0.5?velocity", "bad query field"),
        ("waterlinked://10.0.0.5?velocity=log", '"log" is no sensor of this vehicle (dvl, water)'),
        ("waterlinked://10.0.0.5?altitude=dvl", "altitude is no report of this instrument"),
        ("waterlinked://10.0.0.5?clock=gps", 'clock is "computer" or "instrument", found "gps"'),
    ],
)
def test_a_source_that_cannot_be_is_refused(url, said, tmp_path, capfd):
    from navfilter.io import write_vehicle

    with pytest.raises(ValueError) as error:
        waterlinked(url, VEHICLE)
    assert said in str(error.value)
    write_vehicle(VEHICLE, tmp_path / "auv.toml")
    assert main(["run", "--vehicle", str(tmp_path / "auv.toml"), "--source", url]) == 2
    assert said in capfd.readouterr().err


# --- reports --------------------------------------------------------------------------------------------------------


def test_a_report_is_a_reading():
    source = waterlinked("waterlinked://h?velocity=dvl&velocity_water=water&clock=instrument", VEHICLE)
    line = source.reading(b"2021-11-29 INFO " + report(12.25), 0.0)
    [item] = parsed([line])
    assert (item.sensor, item.time_s, item.value) == ("dvl", 12.25, [0.5, -0.1, 0.02])
    [item] = parsed([source.reading(report(12.25, type="velocity_water"), 0.0)])
    assert item.sensor == "water"
    assert source.reading(report(12.25, type="position_local"), 0.0) is None


def test_a_report_without_a_lock_is_a_missing_reading():
    source = waterlinked("waterlinked://h", VEHICLE)
    for one in (report(1.0, valid=False), report(1.0, ("x", None, math.nan))):
        [item] = parsed([source.reading(one, 5.0)])
        assert all(map(math.isnan, item.value))


def test_the_clock_of_the_computer_counts_less_the_way_of_the_report():
    source = waterlinked("waterlinked://h", VEHICLE)
    # valid 0.15 s before it was sent, whatever the instrument believes the time to be
    assert parsed([source.reading(report(77.0), 1000.0)])[0].time_s == pytest.approx(999.85, abs=1e-6)
    for odd in (report(77.0, time_of_transmission=0), report(77.0, time_of_validity="soon")):
        assert parsed([source.reading(odd, 1000.0)])[0].time_s == 1000.0


def test_angles_are_radians():
    vehicle = nf.Vehicle(nf.DeadReckoning(rate_hz=5), {})
    source = waterlinked("waterlinked://h?position_local=attitude&clock=instrument", vehicle)
    line = source.reading(
        json.dumps({"ts": 3.5, "roll": 1, "pitch": -2.0, "yaw": 90, "type": "position_local"}).encode(), 0.0
    )
    item = LineParser(vehicle).parse(line)
    assert item.time_s == 3.5
    np.testing.assert_allclose(item.value, np.radians([1, -2, 90]), rtol=1e-15)


@pytest.mark.parametrize(
    "line",
    [b"", b"hello", b"{", b'{"type": 3}', b'{"vx": 1}', b"[{}]", b'{"type":' * 30000, b'\xff{"type": "velocity"}\xff',
     report(0.0, time_of_validity=None), report(0.0, time_of_validity=10**400), b"\x00" * 100],
)  # fmt: skip
def test_what_is_no_report_is_told_apart(line):
    with pytest.raises(ValueError, match="report"):
        waterlinked("waterlinked://h?clock=instrument", VEHICLE).reading(line, 0.0)


# --- the connection -------------------------------------------------------------------------------------------------


def test_an_instrument_that_goes_and_comes_back(server, instrument):
    for k in range(3):
        with server.accept() as client:
            client.sendall(report(k) + b"\n" + report(k + 0.5)[:30])  # the last one is cut by the end
    taken(instrument, 3, "gone; connecting again")
    assert [item.time_s for item in parsed(instrument.readings)] == [0.0, 1.0, 2.0]
    assert sum("it speaks" in text for text in instrument.told) == 3


def test_an_instrument_that_is_not_there_yet(server, instrument):
    server.accept().close()
    server.accept_nobody()
    taken(instrument, told="not connected")
    server.socket.listen()
    with server.accept() as client:
        client.sendall(report(1.0) + b"\n")
        taken(instrument, 1)
    # tried a hundred times a second, told once
    assert sum("not connected" in text for text in instrument.told) == 1


def test_an_instrument_that_hangs_up_at_once_is_told_of_once(server, instrument):
    for _ in range(20):
        server.accept().close()
    with server.accept() as client:
        client.sendall(report(1.0) + b"\n")
        taken(instrument, 1, "it speaks")
    assert [text.removeprefix(instrument.source.url) for text in instrument.told] == [
        ": gone; connecting again",
        ": it speaks",
    ]


def test_garbage_between_the_reports(server, instrument):
    with server.accept() as client:
        client.sendall(b"\x00\xff\n{}\nhello\n" + b"x" * 200_000 + b"\n")
        client.sendall(b"".join(b"noise %d\n" % k for k in range(96)) + report(1.0) + b"\r\n")
        taken(instrument, 1, "100 lines that are no report")
    assert [item.time_s for item in parsed(instrument.readings)] == [1.0]
    told = [text for text in instrument.told if "no report" in text]
    assert len(told) == 3  # the first, the tenth, the hundredth


def test_a_slow_instrument(server, instrument):
    with server.accept() as client:
        client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        for byte in report(1.0) + b"\n" + report(2.0) + b"\n":
            client.sendall(bytes([byte]))
        taken(instrument, 2)
    assert [item.time_s for item in parsed(instrument.readings)] == [1.0, 2.0]


def test_an_instrument_that_says_nothing_is_connected_to_again(server, instrument, monkeypatch):
    monkeypatch.setattr(Instrument, "SILENT_S", 0.05)
    first = server.accept()
    stop = threading.Event()

    def babble():
        with contextlib.suppress(OSError):
            while not stop.wait(0.005):
                first.sendall(b"noise\n")

    noise = threading.Thread(target=babble)
    noise.start()
    try:
        # noise is no sign of life
        with server.accept() as second:
            second.sendall(report(1.0) + b"\n")
            taken(instrument, 1, "connecting again")
    finally:
        stop.set()
        noise.join()
        first.close()


def test_what_nobody_takes_is_dropped_and_told(server, instrument, monkeypatch):
    monkeypatch.setattr(Instrument, "MOST", 50)
    with server.accept() as client:
        client.sendall(b"".join(report(k) + b"\n" for k in range(200)))
        # nothing is taken until the last has come
        wait_for(lambda: instrument._readings and b'"time_s":199.0' in instrument._readings[-1])
        taken(instrument, 50, "100 readings dropped")
    assert [item.time_s for item in parsed(instrument.readings)] == [float(k) for k in range(150, 200)]


def test_an_instrument_ends_while_it_is_trying(server, monkeypatch):
    server.accept_nobody()
    monkeypatch.setattr(Instrument, "AGAIN_S", 0.01)
    one = Instrument(waterlinked(server.url, VEHICLE), lambda: None)
    one.start()
    wait_for(lambda: one._told)
    one.close()
    wait_for(lambda: not one._thread.is_alive())


# --- the run --------------------------------------------------------------------------------------------------------


def fed(process, server_side, dive, log, seconds):
    """Feed lines of so many seconds, the DVL's by its own connection; each waits until the one before has been read."""
    sent, second, read = 0, 0, 0
    lines, dvl = [], []
    for line in dive.lines:
        fields = json.loads(line)
        while fields["time_s"] >= second + 1:
            process.send(lines)
            read += len(lines)
            wait_for(lambda: log.exists() and log.read_bytes().count(b'{"sensor": ') == read)  # noqa: B023
            server_side.sendall(b"".join(dvl))
            sent += len(dvl)
            wait_for(lambda: log.exists() and log.read_bytes().count(b'"sensor":"dvl"') == sent)  # noqa: B023
            lines, dvl, second = [], [], second + 1
        if second >= seconds:
            return sent
        if fields["sensor"] == "dvl":
            dvl.append(report(fields["time_s"], fields["value"]) + b"\n")
        else:
            lines.append(line)
    raise AssertionError("the dive is too short")


def test_a_run_with_a_dvl_of_its_own(server, tmp_path):
    """Its readings arrive beside the others, stand in the log, and give the same states again."""
    dive, log = Dive(tmp_path, "lawnmower", 20.0), tmp_path / "log" / LOG_FILE
    source = f"{server.url}?clock=instrument"
    process = Process(*dive.arguments, "--input", "-", "--source", source, "--log", log.parent, "--rate-hz", "1")
    with server.accept() as client:
        sent = fed(process, client, dive, log, 12)
        output = process.end(signal.SIGTERM)
    assert process.code == 0
    found, events = states(output)
    assert sent > 40 and found[-1]["sensors"]["dvl"]["outcomes"]["late-replayed"] > 0
    assert sum(found[-1]["sensors"]["dvl"]["outcomes"].values()) == sent
    assert found[-1]["velocity_sd_m_s"][0] < 0.05
    assert next(event["text"] for event in events if event.get("what") == "source").endswith("it speaks")
    again = Process("--replay-log", log.parent, stdin=None).end()
    kept = [line for line in output if json.loads(line).get("event") not in ("notice", "resume")]
    assert again == kept


def test_a_run_of_sources_alone_reads_no_standard_input(server, tmp_path):
    """Under a supervisor standard input is at its end from the beginning."""
    dive = Dive(tmp_path, "lawnmower", 5.0)
    process = Process(*dive.arguments, "--source", server.url, "--log", tmp_path / "log")
    process.process.stdin.close()
    process.process.stdin = None
    with server.accept() as client:
        client.sendall(report(1.0) + b"\n")
        wait_for(lambda: b'"sensor":"dvl"' in (tmp_path / "log" / LOG_FILE).read_bytes())
        process.end(signal.SIGTERM)
    assert process.code == 0
