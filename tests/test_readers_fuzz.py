"""Property-based tests of the readers: whatever a file holds, the outcome is a mission or one clear error."""

from __future__ import annotations

import lzma
import string
import zipfile
from pathlib import Path

import numpy as np
import pytest
import scipy.io
import scipy.sparse
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from navfilter.io import VehicleError, read_mission, read_vehicle
from navfilter.io.columns import LATEST_S
from navfilter.io.mat5 import check_mat5
from navfilter.io.mission_toml import RunsError
from navfilter.io.table import TableOptions
from navfilter.io.text_tables import read_table
from navfilter.models.mission import Mission, MissionError, Stream

# One folder serves all examples of a test: each example overwrites its files.
QUICK = settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])
NAMES = [".csv", ".csv.gz", ".csv.xz", ".dat", ".npy", ".npz", ".mat"]
FINITE = st.floats(-1e12, 1e12)

TOML = """
[streams.velocity]
file = "log.csv"
time = {column = "t"}
velocity = {columns = ["a", "b", {constant = 0.0}], invalid_above = 50.0}
"""


def one_line(error: BaseException) -> bool:
    return isinstance(error, MissionError) and "\n" not in str(error)


def is_sound(mission: Mission) -> bool:
    for stream in mission.streams.values():
        assert np.isfinite(stream.time_s).all()
        assert (np.diff(stream.time_s) > 0.0).all()
        assert not np.isinf(stream.value).any()
        assert stream.value.shape == (len(stream), 3)
    return True


@QUICK
@given(content=st.binary(max_size=400), suffix=st.sampled_from(NAMES))
def test_any_bytes_are_a_table_or_one_line(tmp_path, content, suffix):
    path = tmp_path / f"any{suffix}"
    path.write_bytes(content)
    try:
        table = read_table(path)
    except MissionError as error:
        assert one_line(error)
        return
    for k in range(len(table.columns)):
        values, unreadable = table.numbers(k)
        assert values.ndim == 1 and 0 <= unreadable <= values.size


@QUICK
@given(text=st.text(string.printable, max_size=300))
def test_any_text_is_a_mission_or_one_line(tmp_path, text):
    (tmp_path / "mission.toml").write_text(TOML)
    (tmp_path / "log.csv").write_text("t,a,b\n" + text, encoding="utf-8")
    try:
        assert is_sound(read_mission(tmp_path))
    except MissionError as error:
        assert one_line(error)


@QUICK
@given(
    rows=hnp.arrays(
        np.float64,
        st.tuples(st.integers(1, 30), st.just(3)),
        elements=st.one_of(FINITE, st.sampled_from([np.nan, np.inf, -np.inf, 0.0, 1.0, 1e308])),
    )
)
def test_numbers_of_any_kind_in_any_order_of_time(tmp_path, rows):
    times = rows[:, 0]
    times[np.abs(times) < LATEST_S] %= 1e6  # of one recording
    (tmp_path / "mission.toml").write_text(TOML)
    np.savetxt(tmp_path / "log.csv", rows, delimiter=",", header="t,a,b", comments="", fmt="%.17g")
    try:
        mission = read_mission(tmp_path)
    except RunsError:
        return  # five rows and more that go on before all others
    except MissionError as error:
        assert one_line(error)
        assert not (np.abs(rows[:, 0]) < LATEST_S).any()
        return
    assert is_sound(mission)
    # Every time that can be one survives once, or is said to stand alone: sorted, without repeats.
    times = np.unique(rows[np.abs(rows[:, 0]) < LATEST_S, 0])
    found = mission.streams["velocity"].time_s
    said = any("no neighbour supports" in note for note in mission.notes)
    np.testing.assert_array_equal(found, times[np.isin(times, found)] if said else times)


@pytest.mark.parametrize("kind", ["csv", "csv.xz", "npz", "mat"])
@QUICK
@given(data=st.data())
def test_truncation_anywhere(tmp_path, kind, data):
    values = np.random.default_rng(0).standard_normal((40, 3))
    path = tmp_path / f"whole.{kind}"
    if kind == "npz":
        np.savez_compressed(path, values=values)
    elif kind == "mat":
        scipy.io.savemat(path, {"values": values})
    else:
        text = "t,a,b\n" + "\n".join(",".join(f"{v:.6f}" for v in row) for row in values)
        path.write_bytes(lzma.compress(text.encode()) if kind.endswith("xz") else text.encode())
    whole = path.read_bytes()
    cut = tmp_path / f"cut.{kind}"
    cut.write_bytes(whole[: data.draw(st.integers(0, len(whole) - 1))])
    try:
        table = read_table(cut, TableOptions())
    except MissionError as error:
        assert one_line(error)
        return
    # A plain text file that ends early is a shorter table; anything packed notices that it was cut.
    assert kind in ("csv", "mat")
    assert all(column.shape[0] <= 40 for column in table.columns.values())


def mat_file(path: Path, **how: bool) -> bytes:
    """A .mat file of version 5 with one of everything that scipy can write."""
    numbers = np.arange(12.0).reshape(4, 3)
    cells = np.array([numbers, "text", 1.0], dtype=object)
    scipy.io.savemat(
        path,
        {"x": numbers, "i": numbers.astype(np.int16), "z": numbers + 1j, "s": {"t": "abc", "n": {"k": cells}}},
        **how,
    )
    scipy.io.savemat(
        path.with_suffix(".b.mat"), {"p": scipy.sparse.csc_array(numbers), "e": [], "b": numbers > 1.0}, **how
    )
    return path.read_bytes()


@pytest.mark.parametrize("packed", [False, True])
def test_every_kind_of_variable_in_a_mat_file_passes(tmp_path, packed):
    """The walk that protects against damaged files must not refuse sound ones."""
    mat_file(tmp_path / "all.mat", do_compression=packed)
    check_mat5(tmp_path / "all.mat")
    check_mat5(tmp_path / "all.b.mat")
    np.testing.assert_array_equal(
        read_table(tmp_path / "all.mat", TableOptions(table="x")).columns["2"], [2.0, 5.0, 8.0, 11.0]
    )


@QUICK
@given(at=st.integers(128, 10_000), bit=st.integers(0, 7), cut=st.booleans())
def test_damage_to_a_mat_file_is_refused_or_harmless(tmp_path, at, bit, cut):
    """scipy ends the process on some of these: a size or a type that is not so must be seen before it reads."""
    whole = bytearray(mat_file(tmp_path / "whole.mat"))
    at = at % len(whole)
    whole[at] ^= 1 << bit
    (tmp_path / "hurt.mat").write_bytes(bytes(whole[: at + 1] if cut else whole))
    try:
        read_table(tmp_path / "hurt.mat", TableOptions(table="x"))
    except MissionError as error:
        assert one_line(error) and "exported pointers" not in str(error)


@pytest.mark.parametrize(
    ("at", "value", "message"),
    [
        (126, b"XX", "it has no header"),
        (128, b"\x03", "of type 3, not a matrix"),
        (132, b"\xff\xff", "ends inside a variable"),
        (136, b"\x05", "flags of a matrix are of type 5"),
        (144, b"\x63", "unknown class 99"),
        (160, b"\xff\xff\xff\xff", "dimensions"),
        (176, b"\x02", "values of a matrix"),
    ],
)
def test_what_contradicts_itself_in_a_mat_file_is_named(tmp_path, at, value, message):
    path = tmp_path / "x.mat"
    scipy.io.savemat(path, {"x": np.arange(6.0).reshape(2, 3)})
    data = bytearray(path.read_bytes())
    data[at : at + len(value)] = value
    path.write_bytes(bytes(data))
    with pytest.raises(MissionError, match=message):
        read_table(path)


def test_an_archive_that_is_called_an_array(tmp_path):
    np.savez(tmp_path / "x.npz", x=np.arange(3.0))
    (tmp_path / "x.npz").rename(tmp_path / "x.npy")
    with pytest.raises(MissionError, match=r"name it \.npz"):
        read_table(tmp_path / "x.npy")


@pytest.mark.parametrize(
    ("stream", "message"),
    [
        ("resample_hz = 100.0", "resample_hz would make 4e"),
        ("average = 2", None),
    ],
)
def test_times_and_values_at_the_edge_of_the_numbers(tmp_path, stream, message):
    """1e14 s is a time, but no neighbour supports it, 1e308 s is none, and a value of 1e308 is no measurement."""
    (tmp_path / "mission.toml").write_text(TOML + stream)
    (tmp_path / "log.csv").write_text("t,a,b\n0,1e308,1e308\n1,1,1\n4e6,1,1\n1e308,1,1\n-1e308,1,1\n1e14,1,1\n")
    if message is None:
        mission = read_mission(tmp_path)
        assert is_sound(mission) and mission.streams["velocity"].time_s.max() < 1e7
        assert any("rows without a readable time" in note for note in mission.notes)
        return
    with pytest.raises(MissionError, match=message):
        read_mission(tmp_path)


@pytest.mark.parametrize("compressed", [False, True])
def test_an_array_that_claims_to_be_shorter_than_it_is(tmp_path, compressed):
    """numpy compares the checksum only at the end of a member, which a header that asks for less never reaches."""
    (np.savez_compressed if compressed else np.savez)(tmp_path / "whole.npz", x=np.arange(60.0).reshape(20, 3))
    with zipfile.ZipFile(tmp_path / "whole.npz") as whole:
        content = whole.read("x.npy")
        with zipfile.ZipFile(tmp_path / "less.npz", "w") as less:
            less.writestr("x.npy", content.replace(b"(20, 3)", b"(10, 3)"))
    with pytest.raises(MissionError, match="longer than it says"):
        read_table(tmp_path / "less.npz")


@QUICK
@given(data=st.data())
def test_a_flipped_byte_in_a_native_file(tmp_path, data):
    mission = Mission("dive", {"depth": Stream(np.arange(50.0), np.sin(np.arange(50.0)), ("depth_m",))})
    whole = bytearray(mission.save(tmp_path / "dive.npz").read_bytes())
    whole[data.draw(st.integers(0, len(whole) - 1))] ^= data.draw(st.integers(1, 255))
    (tmp_path / "hurt.npz").write_bytes(bytes(whole))
    try:
        back = read_mission(tmp_path / "hurt.npz")
    except MissionError as error:
        assert one_line(error)
        return
    # Bytes outside the packed data (dates, attributes) may change unnoticed; the readings may not.
    if "depth" in back.streams:
        np.testing.assert_array_equal(back.streams["depth"].value, mission.streams["depth"].value)


@QUICK
@given(
    time_s=hnp.arrays(np.float64, st.integers(0, 40), elements=st.floats(-1e9, 1e9)),
    columns=st.integers(1, 4),
    name=st.text(min_size=1, max_size=8).filter(lambda text: text.isprintable()),
    data=st.data(),
)
def test_native_round_trip(tmp_path, time_s, columns, name, data):
    value = data.draw(
        hnp.arrays(np.float64, (time_s.size, columns), elements=st.one_of(FINITE, st.just(np.nan), st.just(-0.0)))
    )
    mission = Mission(name, {name: Stream(np.sort(time_s), value)})
    back = read_mission(mission.save(tmp_path / "any.npz"))
    assert back.name == name
    np.testing.assert_array_equal(back.streams[name].time_s, mission.streams[name].time_s)
    assert back.streams[name].value.tobytes() == mission.streams[name].value.tobytes()


KEYS = st.sampled_from(
    [
        "name",
        "date",
        "streams",
        "truth",
        "start",
        "file",
        "time",
        "depth",
        "velocity",
        "columns",
        "unit",
        "sources",
        "x",
    ]
)
LEAVES = st.one_of(
    st.integers(-5, 5), st.floats(allow_nan=False), st.booleans(), st.sampled_from(["a", "", "deg", "truth"])
)
TREES = st.recursive(
    LEAVES,
    lambda inner: st.one_of(st.lists(inner, max_size=3), st.dictionaries(KEYS, inner, max_size=4)),
    max_leaves=12,
)


def toml(value: object) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, dict):
        return "{" + ", ".join(f"{key} = {toml(part)}" for key, part in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(toml, value)) + "]"
    return repr(value).replace("'", '"')


@QUICK
@given(table=st.dictionaries(KEYS, TREES, max_size=5))
def test_any_mission_toml_is_answered_in_words(tmp_path, table):
    (tmp_path / "mission.toml").write_text("\n".join(f"{key} = {toml(value)}" for key, value in table.items()))
    with pytest.raises(MissionError) as caught:
        read_mission(tmp_path)
    assert "mission.toml" in str(caught.value)
    assert "Traceback" not in str(caught.value) and "pydantic" not in str(caught.value)


VEHICLE_KEYS = st.sampled_from(
    ["type", "model", "rate_hz", "error", "sd", "sd_deg", "gyro", "lever_arm_b_m", "tau_s", "x"]
)
VEHICLE_LEAVES = st.one_of(
    st.integers(-5, 5),
    st.floats(allow_nan=False),
    st.booleans(),
    st.sampled_from(["imu", "depth", "white", "arma", "?"]),
)
VEHICLE_TREES = st.recursive(
    VEHICLE_LEAVES,
    lambda inner: st.one_of(st.lists(inner, max_size=3), st.dictionaries(VEHICLE_KEYS, inner, max_size=4)),
    max_leaves=12,
)


@QUICK
@given(drive=VEHICLE_TREES, sensor=VEHICLE_TREES)
def test_any_vehicle_toml_is_a_vehicle_or_answered_in_words(tmp_path, drive, sensor):
    path: Path = tmp_path / "vehicle.toml"
    path.write_text(f"drive = {toml(drive)}\nsensors = {{a = {toml(sensor)}}}\n")
    try:
        read_vehicle(path)
    except VehicleError as error:
        assert "vehicle.toml" in str(error) and "pydantic" not in str(error)
