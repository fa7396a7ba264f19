"""The check of a mission: says nothing of a sound one, and finds each of the usual mistakes in plain words."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import navfilter as nf
from navfilter.check import check_mission, report_text
from navfilter.check.motion import motion_findings
from navfilter.io import geodesy, read_mission, read_vehicle
from navfilter.models.mission import TRUTH_COLUMNS, Mission, Stream
from navfilter.models.state import wrap

IMU = ("rate_x_rad_s", "rate_y_rad_s", "rate_z_rad_s", "force_x_m_s2", "force_y_m_s2", "force_z_m_s2")
V = ("v_x_m_s", "v_y_m_s", "v_z_m_s")
PLACE = ("latitude_rad", "longitude_rad", "height_m")


def motion(seconds: float = 300.0, rate_hz: float = 20.0) -> dict[str, np.ndarray]:
    """A vehicle that weaves, rolls and pitches at 1.5 m/s, seen by perfect sensors."""
    t = np.arange(0.0, seconds, 1.0 / rate_hz)
    yaw = 1.2 * np.sin(0.05 * t) + 0.02 * t
    roll, pitch = 0.15 * np.sin(0.5 * t), 0.1 * np.sin(0.37 * t)
    C = geodesy.matrix_from_euler(roll, pitch, yaw)
    turn = np.einsum("nji,njk->nik", C, np.gradient(C, t, axis=0))
    rate = np.column_stack([turn[:, 2, 1], turn[:, 0, 2], turn[:, 1, 0]])
    force = np.einsum("nji,j->ni", C, np.array([0.0, 0.0, -9.81]))
    v_b = np.column_stack([np.full(t.size, 1.5), 0.6 * np.sin(0.2 * t), np.zeros(t.size)])
    v_n = np.einsum("nij,nj->ni", geodesy.matrix_from_euler(0 * t, 0 * t, yaw), v_b)
    step = 0.5 * (v_n[1:] + v_n[:-1]) / rate_hz
    way = np.vstack([np.zeros(3), np.cumsum(step, axis=0)])
    place = geodesy.geodetic_from_local(way, np.radians(45.0), np.radians(7.0), 0.0)
    field = np.einsum("nji,j->ni", C, np.array([20e-6, 0.0, 40e-6]))
    return {"t": t, "yaw": yaw, "rate": rate, "force": force, "v_b": v_b, "place": place, "field": field}


MOTION = motion()


def mission(
    rate: np.ndarray | None = None,
    force: np.ndarray | None = None,
    heading: np.ndarray | None = None,
    velocity: np.ndarray | None = None,
    dvl_delay_s: float = 0.0,
    compass_delay_s: float = 0.0,
) -> Mission:
    m = MOTION
    rng = np.random.default_rng(3)
    rate = m["rate"] if rate is None else rate
    force = m["force"] if force is None else force
    heading = m["yaw"] if heading is None else heading
    velocity = m["v_b"] if velocity is None else velocity
    noise = lambda shape, sd: sd * rng.standard_normal(shape)  # noqa: E731
    slow = slice(None, None, 4)
    streams = {
        "imu": Stream(m["t"], np.hstack([rate + noise(rate.shape, 1e-3), force + noise(force.shape, 0.02)]), IMU),
        "compass": Stream(
            m["t"][slow] + compass_delay_s,
            wrap(heading[slow] + noise(heading[slow].shape, 0.005)),
            ("heading_rad",),
        ),
        "dvl": Stream(m["t"][slow] + dvl_delay_s, velocity[slow] + noise(velocity[slow].shape, 0.01), V),
        "gps": Stream(m["t"][slow], m["place"][slow] + noise(m["place"][slow].shape, 1.0) * [1e-7, 1e-7, 1.0], PLACE),
    }
    return Mission("weaving", streams)


def said(found_in: Mission, *severities: str) -> str:
    wanted = severities or ("error", "warning")
    return "\n".join(f"{f.stream}: {f.text} {f.cure}" for f in check_mission(found_in) if f.severity in wanted)


def codes(found_in: Mission, *severities: str) -> set[tuple[str, str]]:
    """Stream and code of what is found."""
    wanted = severities or ("error", "warning")
    return {(f.stream, f.code) for f in check_mission(found_in) if f.severity in wanted}


def test_a_sound_mission_is_left_alone():
    assert said(mission()) == ""
    text = report_text(mission(), check_mission(mission()))
    assert "No mistake found" in text
    assert "imu: 6000 readings from 0.00 to 299.95 s, 20 Hz" in text


def test_gravity():
    m = MOTION
    assert ("imu", "sign") in codes(mission(force=-m["force"]), "error")
    assert 'Perhaps the unit is "g"' in said(mission(force=m["force"] / 9.81), "error")
    assert ("imu", "axes") in codes(mission(force=m["force"][:, [2, 1, 0]]), "error")


def test_handedness_and_units_of_the_gyro():
    m = MOTION
    assert "gravity turns the wrong way: gyro x" in said(mission(rate=m["rate"] * [-1, 1, 1]), "error")
    assert "gravity turns the wrong way: gyro y" in said(mission(rate=m["rate"] * [1, -1, 1]), "error")
    degrees = said(mission(rate=np.degrees(m["rate"])), "error")
    assert "57.3; check the unit" in degrees
    assert "the heading turns 0.017" in degrees
    assert ("imu", "unit") in codes(mission(rate=2.0 * np.degrees(m["rate"])), "warning")


def test_gyro_against_heading():
    m = MOTION
    assert ("compass", "sign") in codes(mission(rate=m["rate"] * [1, 1, -1]), "error")
    late = said(mission(compass_delay_s=1.0), "warning")
    # The delay is looked for in steps of 1/16 s.
    delays = [float(line.split(" is ")[1].split(" s late")[0]) for line in late.splitlines() if "late against" in line]
    assert delays == [pytest.approx(1.0, abs=0.07)]
    assert f"Set time.offset_s = {-delays[0]:.2f}" in late


def test_heading_in_degrees():
    slow = mission(heading=np.degrees(MOTION["yaw"]))
    assert "Are these degrees?" in said(
        slow.with_stream("compass", slow.streams["compass"].keep(slice(None, None, 5))), "error"
    )
    assert "the heading turns 57" in said(slow, "error")


def test_velocity_against_position():
    m = MOTION
    assert ("dvl", "axes") in codes(mission(velocity=mirror_case()), "error")
    knots = said(mission(velocity=m["v_b"] / 0.5144), "error")
    assert "0.51" in knots and 'unit = "kn"' in knots
    c = np.sqrt(0.5)
    turned = m["v_b"] @ np.array([[c, -c, 0], [c, c, 0], [0, 0, 1]]).T
    text = said(mission(velocity=turned), "error")
    assert "must be turned by -45.0 deg" in text and "mounting_deg yaw -45" in text
    late = said(mission(dvl_delay_s=1.5), "warning")
    assert "velocity is about 1.5 s late" in late and "lever arm" in late


def mirror_case() -> np.ndarray:
    """A velocity with its side axis reversed, of an instrument turned by 45 degrees, where it matters."""
    c = np.sqrt(0.5)
    return MOTION["v_b"] @ np.array([[c, -c, 0], [c, c, 0], [0, 0, 1]]).T * [1, -1, 1] * [1, 1, 1]


def test_heading_counted_the_other_way():
    # East-counter-clockwise instead of north-clockwise; the gyro is left out, as with a vehicle that has none.
    wrong = mission(heading=np.pi / 2 - MOTION["yaw"]).without_stream("imu")
    assert ("compass", "sign") in codes(wrong, "error")
    assert 'scale = -1 and offset = "90 deg"' in said(wrong, "error")


def test_mounting_without_positions():
    c = np.sqrt(0.5)
    turned = MOTION["v_b"] @ np.array([[c, -c, 0], [c, c, 0], [0, 0, 1]]).T
    text = said(mission(velocity=turned).without_stream("gps"), "warning")
    assert "46 deg right of the instrument's x axis" in text


def test_field_pressure_and_positions():
    m = MOTION
    up = Stream(m["t"], m["field"] * [1, -1, -1], ("field_x_T", "field_y_T", "field_z_T"))
    assert ("mag", "sign") in codes(mission().with_stream("mag", up), "error")
    weak = Stream(m["t"], m["field"] * 1e-3, up.columns)
    assert ("mag", "unit") in codes(mission().with_stream("mag", weak), "warning")
    gauge = Stream(m["t"], 10.0 + 0.1 * m["t"], ("pressure_Pa",))
    assert ("pressure", "unit") in codes(mission().with_stream("pressure", gauge), "error")
    degrees = Stream(m["t"], np.degrees(m["place"]), PLACE)
    assert ("gps", "unit") in codes(mission().with_stream("gps", degrees), "error")
    jump = m["place"].copy()
    jump[500] += [0.001, 0.0, 0.0]
    assert "2 jumps faster" in said(mission().with_stream("gps", Stream(m["t"], jump, PLACE)), "warning")


def test_timing_findings():
    t = np.arange(200.0)
    rng = np.random.default_rng(5)
    noise = rng.standard_normal(200)

    def one(time_s: np.ndarray, value: np.ndarray, *notes: str) -> dict[str, str]:
        found = check_mission(Mission("x", {"depth": Stream(time_s, value, ("depth_m",))}, notes=notes))
        return {f.code: f.text for f in found}

    assert "200 readings from 0.00 to 199.00 s, 1 Hz" in one(t, noise)["rate"]
    assert "51 s at 100.00 s" in one(t + 50.0 * (t > 100), noise)["gap"]
    assert one(np.where(t == 7.0, 6.0, t), noise)["stamps"].startswith("1 ")
    assert "stamps" in one(np.floor(t / 5.0) * 5.0 + 1e-3 * (t % 5), noise)
    assert "held" in one(t, np.repeat(noise[:20], 10))
    assert "stuck" in one(t, np.ones(200))
    assert "empty" in one(t, np.full(200, np.nan))
    assert "12.5 %" in one(t, np.where(t % 8 == 0, np.nan, noise))["empty"]
    assert "few" in one(t[:1], noise[:1])
    assert "steps of 1," in one(t, np.round(0.6 * noise))["quantised"]
    assert "reader" in one(t, noise, "depth (a.csv): 3 steps back in time, by up to 1 s")
    assert not one(t, noise).keys() - {"rate"}


def test_a_stream_that_ends_before_the_others_is_named():
    whole = mission()
    end_s = whole.streams["imu"].time_s[-1]
    for name in ("imu", "dvl"):
        stream = whole.streams[name]
        cut = {**whole.streams, name: stream.keep(stream.time_s < 0.5 * end_s)}
        said = [f for f in check_mission(Mission("cut", cut)) if f.stream == name and f.code == "span"]
        assert [f.severity for f in said] == ["warning"], name
    assert not [f for f in check_mission(whole) if f.code == "span"]
    # a vehicle that ends its mission under water has no fixes there
    fixes = whole.streams["gps"]
    dived = Mission("dived", {**whole.streams, "gps": fixes.keep(fixes.time_s < 0.5 * end_s)})
    assert [f.severity for f in check_mission(dived) if f.code == "span"] == ["info"]


def test_empty_mission():
    assert codes(Mission("x")) == {("", "stream")}
    assert "none" in report_text(Mission("x"), check_mission(Mission("x")))


def test_truth_serves_as_position():
    m = MOTION
    value = np.full((m["t"].size, 9), np.nan)
    value[:, :3] = m["place"]
    whole = mission().without_stream("gps")
    withheld = Mission("x", whole.streams, truth=Stream(m["t"], value, TRUTH_COLUMNS))
    assert "follows the position: scale" in said(withheld, "info")


def test_vehicle_and_mission_are_compared(recording):
    vehicle = read_vehicle(recording("snapir-auv-1hz/01"))
    found = check_mission(mission(), vehicle)
    errors = {f.stream for f in found if f.severity == "error"}
    assert errors == {"attitude", "velocity", "depth", "usbl"}
    unused = {f.stream for f in found if f.code == "stream" and f.severity == "info"}
    assert unused == {"imu", "compass", "dvl", "gps"}


def test_recordings_with_their_known_defects_undone(recording):
    # The clock of the DVL leads by 1.5 s in this recording; the mapping takes it off.
    sound = read_mission(recording("snapir-auv-1hz/03"))
    vehicle = read_vehicle(recording("snapir-auv-1hz/03"))
    dvl = sound.streams["velocity"]
    raw = sound.with_stream("velocity", Stream(dvl.time_s - 1.5, dvl.value, dvl.columns))

    def delays(found_in: Mission) -> list[float]:
        texts = [f.text for f in check_mission(found_in, vehicle) if f.code == "delay"]
        return [float(text.split("about ")[1].split(" s ")[0]) * (-1 if "early" in text else 1) for text in texts]

    assert delays(raw) == [pytest.approx(-1.5, abs=0.5)]
    # At one reading per second half a second cannot be told from how readings are joined.
    assert all(abs(delay) <= 0.5 for delay in delays(sound))


KINDS = {
    "imu": IMU,
    "velocity": V,
    "heading": ("heading_rad",),
    "attitude": ("roll_rad", "pitch_rad", "yaw_rad"),
    "field": ("field_x_T", "field_y_T", "field_z_T"),
    "gps": PLACE,
    "pressure": ("pressure_Pa",),
    "depth": ("depth_m",),
}


@pytest.mark.filterwarnings("error")
@settings(max_examples=100)
@given(
    kinds=st.lists(st.sampled_from(sorted(KINDS)), max_size=4, unique=True),
    rows=st.integers(0, 400),
    missing=st.sampled_from([0.0, 0.3, 1.0]),
    size=st.sampled_from([0.0, 1.0, 1e6]),
    seed=st.integers(0, 5),
    gap_s=st.sampled_from([0.0, 0.5, 1e5]),
)
def test_any_mission_is_judged_without_a_word_of_python(kinds, rows, missing, size, seed, gap_s):
    rng = np.random.default_rng(seed)
    streams = {}
    for kind in kinds:
        n = rows if seed else int(rng.integers(0, rows + 1))
        value = size * rng.standard_normal((n, len(KINDS[kind])))
        value[rng.random(value.shape) < missing] = np.nan
        streams[kind] = Stream(np.cumsum(rng.choice([0.0, 0.1, gap_s], n)), value, KINDS[kind])
    judged = Mission("any", streams)
    assert "Mission any" in report_text(judged, check_mission(judged))


def test_a_clock_that_the_vehicle_describes_is_no_finding():
    late = mission(compass_delay_s=1.0)
    compass = nf.Heading(rate_hz=8.0, time_offset_s=1.0)
    vehicle = nf.Vehicle(imu=nf.Imu(rate_hz=100.0), sensors={"compass": compass})
    found = {f.code for f in motion_findings(late, vehicle) if f.stream == "compass"}
    assert "delay" not in found and "heading" in found


def test_coarse_readings_are_not_held_ones():
    """A heading in steps of a tenth of a degree repeats itself; so does a slower one that is held, all the same."""
    fine = np.radians(30.0 + 0.06 * np.random.default_rng(1).standard_normal(4000))
    coarse = np.radians(0.1) * np.round(fine / np.radians(0.1))
    time_s = 0.125 * np.arange(4000)
    for values, held in ((coarse, False), (np.repeat(fine[:1000], 4), True), (np.repeat(coarse[:1000], 4), True)):
        heading = Mission("x", {"compass": Stream(time_s, values[:, None], ("heading_rad",))})
        assert (("compass", "held") in codes(heading, "warning")) == held
