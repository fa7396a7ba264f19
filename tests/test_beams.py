"""A DVL beam by beam: what a lost or wrong beam costs, bottom and water track of one instrument, honest covariances."""

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import same_runs
from feeding import delayed, events_of, one_by_one
from honest_runs import assert_honest
from scipy.stats import chi2

import navfilter as nf
from navfilter.check.description import describe_vehicle
from navfilter.check.plausibility import check_vehicle
from navfilter.evaluation.assessment import assess
from navfilter.io import write_vehicle
from navfilter.simulation.manoeuvres import ChangeSpeed, Lawnmower, Straight, Wait
from navfilter.simulation.motion import Motion
from navfilter.simulation.scenarios import lawnmower, survey_vehicle
from navfilter.simulation.simulate import Faults, StartErrors, simulate

SEEDS = range(12)
FIXES = ((0.0, 60.0),)
#: A DVL of 5 cm/s beside a good compass: its noise, not the heading, makes the position.
GYRO = nf.White(density=2e-5) + nf.RandomWalk(density=1e-8, start_sd=5e-6)
ACCEL = nf.White(density=1e-3) + nf.RandomWalk(density=1e-6, start_sd=5e-3)
MOTION = Motion((Wait(5.0), ChangeSpeed(1.5, 10.0), Lawnmower(4, 60.0)), latitude_deg=26.0, heading_deg=40.0)


def vehicle_with(**beams):
    given = {"error": nf.White(sd=0.05), "lever_arm_b_m": (0.5, 0.0, 0.1)} | beams
    return nf.Vehicle(
        imu=nf.Imu(rate_hz=20, gyro=GYRO, accel=ACCEL),
        sensors={
            "compass": nf.Heading(rate_hz=4.0, error=nf.White(sd=0.005)),
            "dvl": nf.DvlBeams(rate_hz=4.0, **given),
            "depth": nf.Depth(rate_hz=1.0, error=nf.White(sd=0.05)),
            "gps": nf.Position(rate_hz=1.0, error=nf.White(sd=1.0)),
        },
    )


def simulated(vehicle, seed, **faults):
    faults = {"gps": Faults(available=FIXES)} | faults
    return simulate(vehicle, MOTION, seed=seed, duration_s=300.0, faults=faults, start=StartErrors())


def without_beams(mission, lost):
    stream = mission.streams["dvl"]
    value = stream.value.copy()
    value[:, list(lost)] = np.nan
    return mission.with_stream("dvl", replace(stream, value=value))


@cache
def missions():
    vehicle = vehicle_with(scale_sd=0.005, misalignment_sd_rad=0.005)
    return vehicle, [simulated(vehicle, seed) for seed in SEEDS]


@cache
def runs(lost):
    vehicle, each = missions()
    return [(mission, nf.replay(vehicle, without_beams(mission, lost))) for mission in each]


def test_one_beam_lost_all_the_time_costs_little():
    """On the survey of the scenarios, with a DVL of 1 cm/s: the compass limits the position, not the DVL."""
    plain = survey_vehicle()
    dvl = nf.DvlBeams(rate_hz=4.0, error=nf.White(sd=0.01), lever_arm_b_m=(0.5, 0.0, 0.1))
    vehicle, squares = nf.Vehicle(plain.drive, {**plain.sensors, "dvl": dvl}), {}
    for seed in range(6):
        faults = {"gps": Faults(available="surface")}
        mission = simulate(vehicle, lawnmower(400.0), seed=seed, duration_s=400.0, faults=faults)
        for lost in ((), (2,)):
            track = nf.replay(vehicle, without_beams(mission, lost), output_rate_hz=1.0)
            squares.setdefault(lost, []).append(np.mean(track.errors(mission.truth).horizontal ** 2))
    assert np.mean(squares[(2,)]) <= 1.15**2 * np.mean(squares[()])


def test_two_beams_still_help():
    """They see one horizontal direction and the vertical; the other is left to the inertial unit."""
    vehicle, each = missions()
    alone = [nf.replay(vehicle.without("dvl"), mission) for mission in each[:3]]
    worst = [
        float(np.max(track.errors(mission.truth).horizontal)) for track, mission in zip(alone, each[:3], strict=True)
    ]
    held = [float(np.max(track.errors(mission.truth).horizontal)) for mission, track in runs((0, 2))[:3]]
    # 5e-3 m/s^2 over 240 s are 144 m
    assert sum(held) < 0.5 * sum(worst)


@pytest.mark.parametrize("lost", [(), (2,), (0, 2)])
def test_the_covariance_is_honest(lost):
    """NEES at the end of the way without fixes and in its middle, of all seeds together."""
    assert_honest(runs(lost), 180.0, 299.0)


def test_scale_and_misalignment_come_out():
    names = ("dvl.scale", "dvl.misalignment_z")
    z = [
        (track.state(name)[0][-1] - noted(mission, name)) / track.state(name)[1][-1]
        for mission, track in runs(())
        for name in names
    ]
    # a mean of 24 squares of standard normal numbers: 0.34 to 2.1 in all but one case of a thousand
    assert 0.34 < float(np.mean(np.square(z))) < 2.1


def noted(mission, name):
    what, _, axis = name.removeprefix("dvl.").partition("_")
    note = next(note for note in mission.notes if note.startswith(f"dvl: {what} error"))
    return float(note.split()[3 + "xyz".find(axis or "x")])


def test_a_beam_that_is_wrong_is_left_out_alone():
    vehicle, each = missions()
    stream = each[0].streams["dvl"]
    value = stream.value.copy()
    value[600:700, 1] += 1.0  # a fish in the beam for 25 s
    track = nf.replay(vehicle, each[0].with_stream("dvl", replace(stream, value=value)))
    good = nf.replay(vehicle, without_beams(each[0], ()))
    residuals = track.residuals["dvl"]
    wrong = slice(600, 700)
    assert residuals.count("rejected") == 0 and np.all(residuals.dof[wrong] == 3.0)
    assert np.isnan(residuals.sd[wrong, 1]).all() and np.all(residuals.value[wrong, 1] > 0.5)
    assert np.isfinite(residuals.sd[wrong, 0]).all() and np.all(residuals.dof[:590] >= 3.0)
    apart = track.errors(each[0].truth).horizontal[-1] - good.errors(each[0].truth).horizontal[-1]
    assert abs(apart) < 1.0  # 1 m/s in a beam for 25 s would be 12 m
    text = track.summary(each[0].truth)
    assert text["used"]["dvl"] == len(stream)


def test_a_beam_that_is_left_out_for_long_is_said():
    vehicle, each = missions()
    stream = each[0].streams["dvl"]
    value = stream.value.copy()
    value[len(value) // 2 :, 1] += 1.0
    mission = each[0].with_stream("dvl", replace(stream, value=value))
    found = assess({"forward": nf.replay(vehicle, mission)}, mission).verdict.findings
    (said,) = (finding for finding in found if finding.code == "component")
    assert said.stream == "dvl" and said.text.startswith("beam_2 ") and " 50 % " in said.text
    assert 0.9 < float(said.text.split(" m/s off")[0].split()[-1]) < 1.1


def test_beams_that_contradict_each_other_are_rejected_together():
    """Two and two: nobody knows which pair is right."""
    vehicle, each = missions()
    nav = nf.Navigator(vehicle, each[0].start)
    one_by_one(nav, [event for event in events_of(vehicle, each[0]) if event.true_s < 20.0])
    stream = each[0].streams["dvl"]
    value = stream.value[81].copy()
    value[[0, 1]] += (1.0, -1.0)
    assert nav.correct("dvl", stream.time_s[81] - 0.1, value).status == "rejected"


def test_three_beams():
    vehicle = vehicle_with(beam_azimuth_rad=(0.0, 2.0 * math.pi / 3.0, 4.0 * math.pi / 3.0))
    mission = simulated(vehicle, 3)
    track = nf.replay(vehicle, mission)
    assert np.all(track.residuals["dvl"].dof == 3.0) and np.isnan(track.residuals["dvl"].value[:, 3]).all()
    assert 0.9 < float(np.mean(track.residuals["dvl"].nis)) / 3.0 < 1.1  # 1200 readings: sd 0.024
    assert vehicle.sensors["dvl"].read(np.array([0.1, 0.2, 0.3, 9.0]))[3:].tolist() == pytest.approx(
        [math.nan] * 5, nan_ok=True
    )


def test_bottom_and_water_track_of_one_instrument():
    """Bottom lost for a minute and a half: the current found before carries the position, with one scale for both."""
    water = {"current_sd_m_s": 0.2, "current_tau_s": 6.0 * 3600.0, "scale_sd": 0.01}
    vehicle = vehicle_with(error=nf.White(sd=0.01), **water)
    names = nf.Navigator(vehicle, simulated(vehicle, 1).start).filter.layout.groups["dvl"].names
    assert names[:3] == ("dvl.current_north", "dvl.current_east", "dvl.scale")
    squares, dof = 0.0, 0
    for seed in range(8):
        mission = simulated(vehicle, seed, dvl=Faults(current_m_s=None))
        stream = mission.streams["dvl"]
        assert stream.columns[4:] == tuple(f"water_{i}_m_s" for i in range(1, 5))
        value = stream.value.copy()
        value[(stream.time_s > 150.0) & (stream.time_s < 240.0), :4] = np.nan
        track = nf.replay(vehicle, mission.with_stream("dvl", replace(stream, value=value)))
        inside = (track.time_s > 150.0) & (track.time_s < 240.0)
        # the current changes by 0.2 sqrt(2 * 90 / 21600) m/s in that time: 0.018 m/s, 1 m; without it 20 m
        assert float(np.max(track.errors(mission.truth).horizontal[inside])) < 10.0
        at = int(np.searchsorted(track.time_s, 239.0))
        squares, dof = squares + 3.0 * track.nees(track.errors(mission.truth))["position"][at], dof + 3
    low, high = chi2.ppf([0.001, 0.999], dof)
    assert low < squares < high


def test_a_bottom_track_is_learnt_and_the_water_track_is_not():
    learnt = nf.LearnedArma(prior=nf.White(sd=0.05), orders=((0, 0), (1, 0)), window=400, hop=100)
    vehicle = vehicle_with(error=learnt, current_sd_m_s=0.2)
    true = (nf.GaussMarkov(sd=0.03, tau_s=2.0),) * 4 + (nf.White(sd=0.02),) * 4
    mission = simulated(vehicle, 5, dvl=Faults(true_error=true))
    models = nf.replay(vehicle, mission).error_models["dvl"]
    assert len(models) > 1
    ground, water = models[-1][1][:4], models[-1][1][4:]
    assert water == (nf.White(sd=0.02),) * 4
    assert all(0.7 < -model.model.ar[0] < 0.97 for model in ground)  # exp(-0.25 / 2) = 0.88, from 400 readings
    with pytest.raises(ValueError, match="the current hides in it"):
        vehicle_with(water_error=nf.LearnedArma())


def test_one_mission_file_for_all_beams(tmp_path):
    """Lost beams stand beside good ones; three columns do for three beams; each brings its own sd."""
    (tmp_path / "dvl.csv").write_text("t,a,b,c,d,sa,sb,sc,sd\n0,1,2,3,-32768,1,2,3,4\n1,1,,3,4,1,2,3,4\n")
    text = (
        '[streams.dvl]\nfile = "dvl.csv"\ntime = {column = "t"}\n'
        'beams = {columns = ["a", "b", "c", "d"], unit = "mm/s", invalid = [-32768]}\n'
        'sd = {columns = ["sa", "sb", "sc", "sd"], unit = "mm/s"}\n'
    )
    (tmp_path / "mission.toml").write_text(text)
    stream = nf.read_mission(tmp_path).streams["dvl"]
    np.testing.assert_allclose(stream.value, [[1e-3, 2e-3, 3e-3, np.nan], [1e-3, np.nan, 3e-3, 4e-3]])
    np.testing.assert_allclose(stream.sd, [[1e-3, 2e-3, 3e-3, 4e-3]] * 2)
    (tmp_path / "mission.toml").write_text(text.replace(', "d"]', "]").replace("sd =", "#sd ="))
    assert np.isnan(nf.read_mission(tmp_path).streams["dvl"].value[:, 3]).all()
    (tmp_path / "mission.toml").write_text(text.replace('"sb", "sc", "sd"', '"sb"'))
    with pytest.raises(ValueError, match=r"sd has 2 columns, it needs 1, or one for each of the 4 \(or 8\) axes"):
        nf.read_mission(tmp_path)


def test_the_sd_of_each_beam_counts():
    vehicle, each = missions()
    stream = each[0].streams["dvl"]
    for sd, same in (((0.05,), True), ((0.05,) * 4, True), ((0.05,) * 8, True), ((0.05, 0.05, 0.05, 0.2), False)):
        given = replace(stream, sd=np.tile(sd, (len(stream), 1)))
        track = nf.replay(vehicle, each[0].with_stream("dvl", given))
        assert np.array_equal(track.to_frame(), runs(())[0][1].to_frame(), equal_nan=True) == same
    nav = nf.Navigator(vehicle, each[0].start)
    assert nav.correct("dvl", 0.0, [0.0] * 3 + [0.1], sd=[0.1, 0.1]).status == "invalid"


def test_words_and_file(tmp_path):
    vehicle = vehicle_with(current_sd_m_s=0.3, beam_azimuth_rad=(0.5, 2.0, 4.0))
    text = describe_vehicle(vehicle)
    assert 'Sensor "dvl": velocity over ground and through the water along 3 beams, each judged for itself' in text
    assert "error beam_1 to beam_4" in text and "error water_1 to water_4" in text
    assert not [finding for finding in check_vehicle(vehicle) if finding.severity != "info"]
    assert nf.read_vehicle(write_vehicle(vehicle, tmp_path / "vehicle.toml")) == vehicle
    found = check_vehicle(vehicle_with(beam_tilt_rad=1.05, beam_azimuth_rad=(0.0, 0.01, 0.02), current_sd_m_s=30.0))
    assert {f.stream for f in found if f.severity == "warning"} == {
        f"sensors.dvl.{field}" for field in ("beam_tilt_rad", "beam_azimuth_rad", "current_sd_m_s")
    }


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"beam_azimuth_rad": (0.0, 1.0)}, "beam_azimuth_rad must be 3 or 4 finite angles"),
        ({"beam_azimuth_rad": (0.0, 1.0, math.nan)}, "beam_azimuth_rad must be 3 or 4 finite angles"),
        ({"beam_tilt_rad": 0.0}, "beam_tilt_rad must lie between 0 and pi/2"),
        ({"current_sd_m_s": -1.0}, "current_sd_m_s must be a finite number >= 0"),
        ({"current_sd_m_s": 0.3, "current_tau_s": 0.0}, "current_tau_s must be a finite number > 0"),
        ({"error": (nf.White(sd=0.1),) * 4}, "a tuple of 8"),
    ],
)
def test_wrong_beams_are_refused(wrong, message):
    with pytest.raises(ValueError, match=message):
        nf.DvlBeams(**wrong)


def test_what_is_no_reading():
    dvl = nf.DvlBeams(current_sd_m_s=0.3)
    assert dvl.read(np.zeros(4)) is None and dvl.read(np.full(8, math.nan)) is None
    both = dvl.read(np.array([0.1, 0.2, 99.0, 0.0, 0.0, 0.0, 0.0, 0.0]))
    np.testing.assert_array_equal(both, [0.1, 0.2, np.nan, 0.0, *[np.nan] * 4])
    assert nf.DvlBeams().read(np.arange(8.0))[4:].tolist() == pytest.approx([math.nan] * 4, nan_ok=True)


def test_straight_on_a_beam_reads_its_share_of_the_speed():
    """From the definition: 30 degrees from down, 45 off the bow, and forward at 2 m/s."""
    motion = Motion((Straight(20.0),), latitude_deg=30.0, heading_deg=70.0, speed_m_s=2.0)
    dvl = nf.DvlBeams(rate_hz=1.0, error=nf.White(sd=1e-9))
    mission = simulate(nf.Vehicle(imu=nf.Imu(rate_hz=20), sensors={"dvl": dvl}), motion, seed=1, duration_s=5.0)
    share = 2.0 * math.sin(math.radians(30.0)) * math.cos(math.radians(45.0))
    np.testing.assert_allclose(mission.streams["dvl"].value[2], [share, -share, -share, share], atol=1e-3)


def test_simulated_tracks_err_as_described():
    """Water track by its own model: the NIS of both together is honest."""
    vehicle = vehicle_with(current_sd_m_s=0.2, water_error=nf.White(sd=0.1))
    mission = simulated(vehicle, 7)
    residuals = nf.replay(vehicle, mission).residuals["dvl"]
    assert np.all(residuals.dof == 8.0)
    assert 0.95 < float(np.mean(residuals.nis)) / 8.0 < 1.05  # 1200 readings of eight: sd 0.014


def test_late_and_restored_beams_are_in_order():
    """Pings up to 1.5 s late, and a snapshot half-way, give what arrival in order gives."""
    vehicle = vehicle_with(current_sd_m_s=0.2)
    mission = simulated(vehicle, 8).between(0.0, 40.0)
    events = events_of(vehicle, mission)
    late = delayed(events, ("dvl",), 1.5, seed=1)
    ordered, mixed = nf.Navigator(vehicle, mission.start), nf.Navigator(vehicle, mission.start)
    one_by_one(ordered, events)
    outcomes = [outcome.status for outcome in one_by_one(mixed, late[:600])]
    assert outcomes.count("late-replayed") > 30
    restored = nf.Navigator.restore(vehicle, mixed.snapshot())
    for nav in (mixed, restored):
        one_by_one(nav, late[600:])
    same_runs.assert_same_bits(mixed, restored)
    same_runs.assert_same_estimate(ordered, mixed)
