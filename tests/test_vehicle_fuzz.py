"""What a vehicle reads, property by property: vehicle.toml, mission.toml, JSON lines, snapshots. The millions:
benchmarks/fuzz.py.
"""

from __future__ import annotations

import json
import math
import re

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from navfilter.check.description import describe_vehicle
from navfilter.check.plausibility import check_vehicle
from navfilter.io import VehicleError, read_mission, read_vehicle, write_vehicle
from navfilter.io.json_lines import BAD_KINDS, BadLine, LineParser, Reading
from navfilter.io.vehicle_template import DRIVES, vehicle_template
from navfilter.models.error_models import Arma, GaussMarkov, RandomWalk, White
from navfilter.models.learned_arma import LearnedArma
from navfilter.models.mechanisation import DeadReckoning, Imu
from navfilter.models.mission import MissionError
from navfilter.models.sensors import BodyVelocity, Depth, Heading, Position, WaterVelocity, ZeroVelocity
from navfilter.models.start import Start
from navfilter.models.vehicle import RESERVED, Vehicle
from navfilter.navigation.navigator import Navigator
from navfilter.service.protocol import Lines, to_line
from navfilter.timeseries.model import ArmaModel, is_stable

QUICK = settings(max_examples=25, suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow])


# --- any vehicle ----------------------------------------------------------------------------------------------------


def sizes(least=0.0, most=1e6):
    """Zero, or a number of any magnitude in between."""
    return st.one_of(st.just(max(least, 0.0)), st.floats(max(least, 1e-9), most))


COEFFICIENTS = st.lists(st.floats(-1.9, 1.9), max_size=4).map(tuple).filter(is_stable)
FIXED = st.one_of(
    st.builds(White, sd=sizes()),
    st.builds(lambda density: White(density=density), sizes()),
    st.builds(RandomWalk, density=sizes(), start_sd=st.one_of(st.none(), sizes())),
    st.builds(GaussMarkov, sd=sizes(), tau_s=st.floats(1e-3, 1e9), order=st.integers(1, 4)),
    st.builds(Arma, ar=COEFFICIENTS, ma=st.lists(st.floats(-5.0, 5.0), max_size=3).map(tuple), sd=sizes()),
)


@st.composite
def adopted(draw):
    ar, ma = draw(COEFFICIENTS), draw(st.lists(st.floats(-0.9, 0.9), max_size=3))
    n = len(ar) + len(ma)
    covariance = draw(st.one_of(st.none(), st.just(np.diag(np.arange(1.0, n + 1.0)) - 0.1)))
    spread = draw(st.one_of(st.none(), sizes(), st.just(math.inf)))
    return ArmaModel(
        ar,
        ma,
        draw(sizes()),
        covariance,
        spread,
        draw(st.one_of(st.none(), sizes())),
        draw(st.frozensets(st.text(max_size=3))),
    )


PAIR = st.tuples(st.integers(0, 10), st.integers(0, 10))
PRIOR = st.one_of(FIXED, st.builds(lambda a, b: a + b, FIXED, FIXED))


def errors(prior):
    """Fixed, learnt, and sums of them; `prior` is what a learnt one may have."""
    learned = st.builds(
        LearnedArma,
        prior=prior,
        orders=st.lists(PAIR, min_size=1, max_size=4).map(tuple),
        window=st.integers(423, 10_000),
        hop=st.one_of(st.none(), st.integers(1, 5000)),
        model=st.one_of(st.none(), adopted()),
    )
    return st.one_of(FIXED, learned, st.builds(lambda a, b: a + b, FIXED, st.one_of(FIXED, learned)))


def three(error):
    """One for all axes, or one each."""
    return st.one_of(error, st.tuples(error, error, error))


ERROR, WITH_PRIOR = errors(st.one_of(st.none(), PRIOR)), errors(PRIOR)
THREE = three(ERROR)
VECTOR = st.tuples(*[st.floats(-50.0, 50.0)] * 3)
RATE = st.floats(0.01, 1000.0)
SHARED = {"rate_hz": RATE, "gate_probability": st.floats(0.5, 0.999999), "gate_timeout_s": st.floats(0.1, 1e6)}
SENSOR = st.one_of(
    st.builds(
        BodyVelocity,
        error=THREE,
        lever_arm_b_m=VECTOR,
        mounting_rad=VECTOR,
        scale_sd=sizes(),
        zero_is_invalid=st.booleans(),
        **SHARED,
    ),
    st.builds(
        Heading,
        error=ERROR,
        declination_rad=st.one_of(st.none(), st.floats(-7.0, 7.0)),
        deviation_sd_rad=st.tuples(sizes(), sizes()),
        **SHARED,
    ),
    st.builds(
        WaterVelocity,
        error=three(FIXED),
        current_sd_m_s=st.floats(1e-3, 10.0),
        current_tau_s=st.floats(1.0, 1e6),
        scale_sd=sizes(),
        **SHARED,
    ),
    st.builds(
        Depth, error=ERROR, latitude_deg=st.floats(-90.0, 90.0), pressure=st.booleans(), offset_sd_m=sizes(), **SHARED
    ),
    st.builds(
        Position,
        error=THREE,
        lever_arm_b_m=VECTOR,
        max_hdop=st.floats(0.1, 100.0),
        antenna_height_m=st.none() | st.floats(-100.0, 9000.0),
        **SHARED,
    ),
    st.builds(ZeroVelocity, error=THREE, gyro_mean_max=st.floats(1e-6, 10.0), **SHARED),
)
DRIVE = st.one_of(
    st.builds(
        Imu,
        rate_hz=RATE,
        gyro=THREE,
        accel=THREE,
        increments=st.booleans(),
        gyro_scale_sd=st.one_of(sizes(), st.tuples(sizes(), sizes(), sizes())),
        accel_misalignment_sd_rad=sizes(),
    ),
    st.builds(
        DeadReckoning,
        rate_hz=RATE,
        attitude=st.one_of(three(WITH_PRIOR), st.builds(Heading, error=ERROR, rate_hz=RATE, bias_sd_rad=sizes())),
        velocity=st.one_of(THREE, st.builds(BodyVelocity, error=THREE, rate_hz=RATE, mounting_rad=VECTOR)),
        tilt=FIXED,
    ),
)
NAME = st.text(min_size=1, max_size=6).filter(lambda text: text.isprintable() and text.strip() and text not in RESERVED)
VEHICLE = st.builds(Vehicle, drive=DRIVE, sensors=st.dictionaries(NAME, SENSOR, max_size=2), name=NAME)


@QUICK
@given(vehicle=VEHICLE)
def test_any_vehicle_comes_back_and_can_be_described(tmp_path, vehicle):
    assert read_vehicle(write_vehicle(vehicle, tmp_path / "v.toml")) == vehicle
    assert describe_vehicle(vehicle).startswith(f'Vehicle "{vehicle.name}": ')
    for finding in check_vehicle(vehicle):
        assert finding.text and (finding.cure or finding.severity == "info")


# --- broken text ----------------------------------------------------------------------------------------------------

WORDS = """[ ] { } = , [] {} inf nan -1 0 1e400 true model sd sd_deg white learned-arma type depth columns time rate_hz unit adopted
    2026-06-01"""
PIECES = st.sampled_from(["", '"', "#", "\n", "\\", "\x00", "é", "9" * 30, *WORDS.split()])
MISSION = """
name = "dive"
zero_s = "first"
[streams.dvl]
file = "log.csv"
average = 2
time = {column = "t", offset_s = 1.0}
velocity = {columns = ["a", "b", {constant = 0.0}], unit = "cm/s", axes = "y,-x,z", invalid = [-1.0]}
[streams.gps]
file = "log.csv"
time = {rate_hz = 4.0}
resample_hz = 2.0
local = {columns = ["a", "b", "a"], origin = {latitude_deg = 45.0, longitude_deg = 10.0}}
[start]
latitude_deg = 45.0
longitude_deg = 10.0
"""


@st.composite
def broken(draw, text):
    """A text in which some tokens are other ones."""
    for _ in range(draw(st.integers(1, 4))):
        tokens = list(re.finditer(r'"[^"\n]*"|[\w.+-]+|[^\s\w]', text))
        if not tokens:
            break
        token = tokens[draw(st.integers(0, len(tokens) - 1))]
        text = text[: token.start()] + draw(PIECES) + text[token.end() :]
    return text


@pytest.mark.parametrize("drive", DRIVES)
@QUICK
@given(data=st.data())
def test_a_broken_vehicle_toml_is_a_vehicle_or_answered_in_words(tmp_path, drive, data):
    keys = re.sub(r"(?m)^# .*\n|^#(?=\w|\[)", "", vehicle_template(drive))
    path = tmp_path / "vehicle.toml"
    path.write_text(data.draw(broken(keys)))
    try:
        vehicle = read_vehicle(path)
    except VehicleError as error:
        first, *rest = str(error).split("\n")
        assert str(path) in first and "pydantic" not in str(error)
        # One line for each mistake, and each says where.
        assert not rest or (
            first.endswith(f"{len(rest)} mistakes:") and all(re.match(r"  \S.*: .", line) for line in rest)
        )
        return
    assert read_vehicle(write_vehicle(vehicle, tmp_path / "again.toml")) == vehicle
    assert describe_vehicle(vehicle)
    check_vehicle(vehicle)


@QUICK
@given(text=broken(MISSION))
def test_a_broken_mission_toml_is_a_mission_or_answered_in_words(tmp_path, text):
    (tmp_path / "log.csv").write_text("t,a,b\n" + "".join(f"{k / 4},{k},{-k}\n" for k in range(20)))
    (tmp_path / "mission.toml").write_text(text)
    try:
        mission = read_mission(tmp_path)
    except MissionError as error:
        assert len(str(error)) > 10 and "pydantic" not in str(error) and "Traceback" not in str(error)
        return
    for stream in mission.streams.values():
        assert np.isfinite(stream.time_s).all() and not np.isinf(stream.value).any()


# --- JSON lines -----------------------------------------------------------------------------------------------------

ON_BOARD = Vehicle(imu=Imu(rate_hz=10.0), sensors={"compass": Heading(), "gps": Position()})
JSON = st.recursive(
    st.one_of(st.none(), st.booleans(), st.integers(-(10**400), 10**400), st.floats(), st.text(max_size=5)),
    lambda inner: st.one_of(
        st.lists(inner, max_size=4),
        st.dictionaries(st.sampled_from(["sensor", "time_s", "value", "x"]), inner, max_size=4),
    ),
    max_leaves=8,
)
FIELDS = st.fixed_dictionaries(
    {"sensor": st.one_of(st.sampled_from(["imu", "compass", "gps", "start", "sonar"]), JSON)},
    optional=dict.fromkeys(
        ["time_s", "value", "sd", "rate_b", "force_b", "latitude_deg", "longitude_deg", "date", "event", "kind"], JSON
    ),
)


@pytest.mark.parametrize("notes", [False, True])
@QUICK
@given(
    line=st.one_of(
        st.binary(max_size=60), FIELDS.map(lambda f: json.dumps(f).encode()), JSON.map(lambda f: json.dumps(f).encode())
    )
)
def test_any_line_is_a_reading_or_a_bad_line(notes, line):
    for parser in (LineParser(notes=notes), LineParser(ON_BOARD, notes=notes)):
        item = parser.parse(line)
        if isinstance(item, BadLine):
            assert item.kind in BAD_KINDS and (item.text or notes)
            assert item.raw.endswith(b"\n") and json.loads(item.raw)["event"] == "bad"
        elif isinstance(item, Reading):
            assert math.isfinite(item.time_s) and not np.isinf(item.value).any() and len(item.value) >= 1


@QUICK
@given(
    time_s=st.floats(-1e10, 1e10),
    value=st.lists(
        st.one_of(st.floats(allow_nan=False, allow_infinity=False), st.just(math.nan)), min_size=3, max_size=16
    ),
    data=st.data(),
)
def test_a_reading_survives_its_line_however_it_is_cut(time_s, value, data):
    """NaN leaves as null and comes back as NaN; every other number comes back to the bit."""
    stream = 3 * to_line({"sensor": "gps", "time_s": time_s, "value": value})
    cutter, lines, at = Lines(), [], 0
    while at < len(stream):
        size = data.draw(st.integers(1, 80))
        lines += cutter.feed(stream[at : at + size])
        at += size
    assert len(lines) == 3 and not any(cut for _, cut in lines) and not list(cutter.end())
    for line, _ in lines:
        item = LineParser(ON_BOARD).parse(line)
        assert isinstance(item, Reading) and (item.sensor, item.time_s) == ("gps", time_s)
        np.testing.assert_array_equal(item.value, value)


# --- snapshots ------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def taken():
    """A vehicle that learns, a navigator of it after five seconds, and its snapshot."""
    learned = LearnedArma(prior=GaussMarkov(sd=0.01, tau_s=30.0), window=200)
    vehicle = Vehicle(
        imu=Imu(rate_hz=10.0), sensors={"compass": Heading(rate_hz=1.0, error=learned), "gps": Position()}
    )
    nav = Navigator(vehicle, Start(latitude_deg=45.0, longitude_deg=10.0))
    for k in range(1, 51):
        nav.step(0.1 * k, np.zeros(3), np.array([0.0, 0.0, -9.8]))
        if k % 10 == 0:
            nav.correct("compass", 0.1 * k, 0.01)
    return vehicle, nav, nav.snapshot()


def same(a: Navigator, b: Navigator) -> None:
    for nav in (a, b):
        assert nav.state.covariance is not None
    assert (a.time_s, a.state.latitude, a.state.longitude) == (b.time_s, b.state.latitude, b.state.longitude)
    np.testing.assert_array_equal(a.state.covariance, b.state.covariance)


@QUICK
@given(data=st.data())
def test_a_damaged_snapshot_is_refused(taken, data):
    vehicle, nav, whole = taken
    at = data.draw(st.integers(0, len(whole) - 1))
    kind = data.draw(st.sampled_from(["flip", "cut", "insert", "repeat"]))
    hurt = {
        "flip": whole[:at] + bytes([whole[at] ^ data.draw(st.integers(1, 255))]) + whole[at + 1 :],
        "cut": whole[:at],
        "insert": whole[:at] + data.draw(st.binary(min_size=1, max_size=9)) + whole[at:],
        "repeat": whole[: at + 1] + whole,
    }[kind]
    try:
        back = Navigator.restore(vehicle, hurt)
    except ValueError as error:
        assert type(error) is ValueError and "snapshot" in str(error) and str(error).endswith(".")
        return
    # The header also says for whom and when, which nothing is computed from: damage there alone goes unseen.
    assert at < whole.index(b"\n", whole.index(b"\n") + 1)
    same(back, nav)


@QUICK
@given(junk=st.binary(max_size=300))
def test_junk_is_no_snapshot(taken, junk):
    vehicle, _, whole = taken
    for data in (junk, whole.split(b"\n")[0] + b"\n" + junk):
        with pytest.raises(ValueError, match="snapshot"):
            Navigator.restore(vehicle, data)


def test_a_whole_snapshot_goes_on(taken):
    vehicle, nav, whole = taken
    same(Navigator.restore(vehicle, whole), nav)
