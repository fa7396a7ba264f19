"""Dead reckoning between its readings, and sensors beside it: arcs, what goes on evenly, arms that turn."""

import math

import numpy as np
import pytest
from kernel_inputs import assert_close, drive_result, random_drive, random_nav, run_both

import navfilter as nf
from navfilter.kernels import strapdown
from navfilter.simulation.manoeuvres import ChangeSpeed, Dive, Straight, Turn, Wait
from navfilter.simulation.motion import Motion
from navfilter.simulation.scenarios import lawnmower, turns_and_dives
from navfilter.simulation.simulate import StartErrors, simulate

DEG = math.pi / 180.0
WELL = StartErrors(heading_sd_deg=0.1, tilt_sd_deg=0.1, position_sd_m=0.05)
BEGIN = (Wait(10.0), ChangeSpeed(4.0, 15.0), Straight(duration_s=30.0))


def reckoning(rate_hz, velocity=None, heading=None, **sensors):
    """By readings of this rate, which err little if nothing is said."""
    velocity = velocity or nf.BodyVelocity(error=nf.White(sd=0.003), zero_is_invalid=False)
    heading = heading or nf.Heading(error=nf.White(sd=0.02 * DEG))
    drive = nf.DeadReckoning(rate_hz=rate_hz, attitude=heading, velocity=velocity, tilt=nf.White(sd=0.02 * DEG))
    return nf.Vehicle(drive, sensors)


def nees(vehicle, way, seeds, duration_s, **how):
    """Median over missions of the means of position, velocity and heading; forward."""
    found = []
    for seed in seeds:
        mission = simulate(vehicle, way, seed=seed, duration_s=duration_s, start=WELL)
        track = nf.replay(vehicle, mission, **how)
        of = track.nees(track.errors(mission.truth))
        found.append([np.nanmean(of[what][track.time_s > 30.0]) for what in ("position", "velocity", "heading")])
    return np.median(found, axis=0)


def test_between_readings_the_vehicle_turns_on():
    """Rows at 4 Hz of readings at 0.5 Hz. The velocity was held in n, as sure as when it was read: NEES 72."""
    vehicle = reckoning(0.5, gps=nf.Position(rate_hz=1.0, error=nf.White(sd=0.5)))
    assert np.all(nees(vehicle, turns_and_dives(600.0), range(4), 600.0, output_rate_hz=4.0) < 3.0)


def test_fixes_between_readings_tell_their_clock():
    """While the vehicle gains speed, fixes between its readings are ahead of where a held velocity has brought it.
    What they tell of that must not stay beyond the next reading: it is the velocity by the clock in every mission.
    """
    changes = ChangeSpeed(2.0, 5.0), Straight(duration_s=20.0), ChangeSpeed(5.0, 10.0), Straight(duration_s=20.0)
    way = Motion((*BEGIN, *changes * 10), latitude_deg=40.0)
    vehicle = reckoning(1.0, gps=nf.Position(rate_hz=5.0, error=nf.White(sd=0.02), time_offset_sd_s=0.09))
    for seed in range(3):
        mission = simulate(vehicle, way, seed=seed, duration_s=500.0, start=WELL)
        track = nf.replay(vehicle, mission)
        drawn = next(float(note.split(" error ")[1]) for note in mission.notes if "time offset" in note)
        assert track.states[-1, track.state_names.index("gps.time_offset")] == pytest.approx(drawn, abs=0.005)


def test_fixes_on_an_arm_tell_no_heading_while_it_turns():
    """Found by random vehicles: an antenna 5 m off, fixes that err by centimetres for 13 s, heading read at 2 Hz. Held
    headings are behind in turns, always to the same side, and what the antenna tells of that must not stay: NEES of
    the velocity 2.1.
    """
    heading = nf.Heading(error=nf.GaussMarkov(sd=1.9 * DEG, tau_s=5.0) + nf.White(sd=0.75 * DEG))
    fixes = nf.Position(rate_hz=5.0, error=nf.GaussMarkov(sd=0.026, tau_s=12.6), lever_arm_b_m=(-3.5, -3.3, 2.0))
    way = Motion((*BEGIN, *(Turn(90.0), Straight(duration_s=50.0), Turn(-140.0)) * 6), latitude_deg=40.0)
    assert np.all(nees(reckoning(2.0, heading=heading, gps=fixes), way, range(4), 500.0) < 2.0)


def test_the_arm_of_a_velocity_beside_it_turns():
    """A log reckons, a DVL on an arm of 4 m corrects it. The angular rate was taken for zero, so that each turn moved
    the velocity by 0.4 m/s: NEES of position and velocity 3.5 and 2.8.
    """
    axes = nf.GaussMarkov(sd=0.15, tau_s=60.0), nf.GaussMarkov(sd=0.05, tau_s=60.0), nf.White(sd=0.02)
    log = nf.WaterVelocity(error=axes, zero_is_invalid=False, current_sd_m_s=0.1, current_tau_s=420.0)
    bottom = nf.BodyVelocity(rate_hz=1.0, error=nf.White(sd=0.05), lever_arm_b_m=(2.9, -2.0, 2.5))
    vehicle = reckoning(8.0, log, bottom=bottom, depth=nf.Depth(rate_hz=1.0, error=nf.White(sd=0.03)))
    assert np.all(nees(vehicle, lawnmower(600.0), range(4), 600.0)[:2] < 1.8)


@pytest.mark.parametrize("current", [-1, 4])
def test_what_is_held_is_taken_back(current):
    """Turning and gaining speed, through water or not; and a state that has been held comes back to where it was."""
    rng = np.random.default_rng(5)
    settings = {
        "LEVER": (0.8, -0.3, 0.4),
        "CURRENT": current,
        "TURNING": (0.05, -0.1, 0.2),
        "GAINING": (0.3, 0.1, -0.2),
    }
    drv, xd, Phid, Qd, Cr, acc = random_drive(rng, 6, PERIOD_S=0.5, TURN_CHANGE=0.1, SPEED_CHANGE=0.2, **settings)
    nav = random_nav(rng)
    before = nav.copy()
    ours, twins = run_both(strapdown.dead_reckoning_hold, nav, xd, drv, 0.3, Phid, Qd, Cr, acc)
    assert_close(drive_result(ours), drive_result(twins))
    nav = ours[0]
    strapdown.dead_reckoning_hold(nav, xd, drv, -0.3, Phid, Qd, Cr, acc)
    np.testing.assert_allclose(nav[3:15], before[3:15], rtol=0.0, atol=1e-12)
    np.testing.assert_allclose((nav[:3] - before[:3]) * [6e6, 6e6, 1.0], 0.0, atol=1e-3)


def test_an_unseen_turn_leaves_nothing_behind_the_next_reading():
    """While readings are held they may err by a turn; the next one says what it was. Through a lever arm a third of it
    stayed, in position and velocity.
    """
    drv, xd, Phid, Qd, Cr, acc = random_drive(np.random.default_rng(1), 1, PERIOD_S=0.5, LEVER=(-1.2, 1.5, 0.9))
    nav, Phid[:], Qd[:], Cr[:], start = random_nav(np.random.default_rng(1)), 1.0, 0.0, 0.0, acc.copy()
    xd[:] = 0.0

    def sample(n):
        acc[:] = start
        turned = 0.01 * n * np.array([0.2, 1.0, 3.0])
        strapdown.dead_reckoning_steps(nav, xd, drv, np.array([[0.5, *turned, 1.5, 0.0, 0.1]]), Phid, Qd, Cr, acc)

    for n in range(4):
        sample(n)
    drv[strapdown.TURN_CHANGE], drv[strapdown.SPEED_CHANGE], drv[strapdown.SPEED_USUAL] = 0.1, 0.0, 0.0
    acc[:] = start
    strapdown.dead_reckoning_hold(nav, xd, drv, 0.3, Phid, Qd, Cr, acc)
    held = acc[10:19, :9].copy()
    sample(4)
    left = acc[:9, :9] @ held @ acc[:9, :9].T
    # what is left is of second order: the turn that goes on times the unseen one
    assert np.sqrt(np.trace(left[:3, :3])) < 0.02 * np.sqrt(np.trace(held[:3, :3]))
    assert np.sqrt(np.trace(left[3:6, 3:6])) < 0.02 * np.sqrt(np.trace(held[3:6, 3:6]))


def test_a_way_that_bends_is_not_cut_short():
    """Dives of 35 deg and turns, read once a second without errors. The trapezoidal rule is ahead of the way while it
    bends: 7 mm (rms) in depth and 6 mm in the plane, a gauge of millimetres saw it and told the clock of the attitude.
    """
    cycle = Dive(25.0, 35.0), Straight(duration_s=10.0), Dive(5.0, 35.0), Turn(120.0)
    way = Motion((*BEGIN[:1], ChangeSpeed(1.5, 15.0), Straight(duration_s=30.0), *cycle * 4), latitude_deg=40.0)
    never = nf.White(sd=1e-6)
    heading, velocity = nf.Heading(error=never), nf.BodyVelocity(error=never, zero_is_invalid=False)
    vehicle = nf.Vehicle(nf.DeadReckoning(rate_hz=1.0, attitude=heading, velocity=velocity, tilt=never), {})
    known = StartErrors(heading_sd_deg=1e-4, tilt_sd_deg=1e-4, velocity_sd_m_s=1e-4, position_sd_m=1e-4)
    mission = simulate(vehicle, way, seed=1, duration_s=300.0, start=known)
    track = nf.replay(vehicle, mission)
    error = track.errors(mission.truth).position_n
    plane, down = np.sqrt(np.mean(error[:, :2] ** 2)), np.sqrt(np.mean(error[:, 2] ** 2))
    assert plane < 0.0015 and down < 0.0035


def test_noise_of_a_log_does_not_tell_its_clock():
    """Found by random vehicles: a log that drives at 8 Hz and scatters by 2 cm/s, a DVL beside it. Slopes that had the
    noise of the reading which the DVL judges told its clock: 0.2 to 0.6 s early, by 15 of its sd.
    """
    log = nf.WaterVelocity(error=nf.White(sd=0.02), zero_is_invalid=False, current_sd_m_s=0.3, time_offset_sd_s=0.09)
    bottom, fixes = nf.BodyVelocity(rate_hz=1.0, error=nf.White(sd=0.01)), nf.Position(rate_hz=1.0)
    vehicle, off = reckoning(8.0, log, bottom=bottom, gps=fixes), []
    for seed in range(4):
        mission = simulate(vehicle, turns_and_dives(1200.0), seed=seed, duration_s=1200.0, start=WELL)
        track = nf.replay(vehicle, mission)
        drawn = next(float(note.split(" error ")[1]) for note in mission.notes if "time offset" in note)
        place = track.state_names.index("velocity.time_offset")
        off.append((track.states[-1, place] - drawn) / track.states_sd[-1, place])
    assert np.mean(np.square(off)) < 4.0, off
