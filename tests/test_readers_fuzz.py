"""Property-based tests of the readers: whatever a file holds, the outcome is a mission or one clear error."""

from __future__ import annotations

import lzma
import string
from pathlib import Path

import numpy as np
import pytest
import scipy.io
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from navfilter.io import VehicleError, read_mission, read_vehicle
from navfilter.io.tables import TableOptions, read_table
from navfilter.mission import Mission, MissionError, Stream

# One folder serves all examples of a test: each example overwrites its files.
QUICK = settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
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
    (tmp_path / "mission.toml").write_text(TOML)
    np.savetxt(tmp_path / "log.csv", rows, delimiter=",", header="t,a,b", comments="", fmt="%.17g")
    try:
        mission = read_mission(tmp_path)
    except MissionError as error:
        assert one_line(error)
        assert not np.isfinite(rows[:, 0]).any()
        return
    assert is_sound(mission)
    # Every finite time survives once: sorted, without repeats.
    times = np.unique(rows[np.isfinite(rows[:, 0]), 0])
    np.testing.assert_array_equal(mission.streams["velocity"].time_s, times)


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
    value = data.draw(hnp.arrays(np.float64, (time_s.size, columns), elements=st.one_of(FINITE, st.just(np.nan), st.just(-0.0))))
    mission = Mission(name, {name: Stream(np.sort(time_s), value)})
    back = read_mission(mission.save(tmp_path / "any.npz"))
    assert back.name == name
    np.testing.assert_array_equal(back.streams[name].time_s, mission.streams[name].time_s)
    assert back.streams[name].value.tobytes() == mission.streams[name].value.tobytes()


KEYS = st.sampled_from(
    ["name", "date", "streams", "truth", "start", "file", "time", "depth", "velocity", "columns", "unit", "sources", "x"]
)
LEAVES = st.one_of(st.integers(-5, 5), st.floats(allow_nan=False), st.booleans(), st.sampled_from(["a", "", "deg", "truth"]))
TREES = st.recursive(LEAVES, lambda inner: st.one_of(st.lists(inner, max_size=3), st.dictionaries(KEYS, inner, max_size=4)), max_leaves=12)


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


VEHICLE_KEYS = st.sampled_from(["type", "model", "rate_hz", "error", "sd", "sd_deg", "gyro", "lever_arm_b_m", "tau_s", "x"])
VEHICLE_LEAVES = st.one_of(
    st.integers(-5, 5), st.floats(allow_nan=False), st.booleans(), st.sampled_from(["imu", "depth", "white", "arma", "?"])
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
