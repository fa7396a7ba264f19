"""What arrives has a defined outcome, is counted, and never leaves a NaN; blocks and single samples are the same
arithmetic.
"""

import dataclasses
import math
import pickle

import numpy as np
import pytest
import same_runs
from feeding import DRIVE, Event, one_by_one

import navfilter as nf
from navfilter.filter.records import OUTCOMES
from navfilter.filter.rts_smoother import smooth_rows

DEG = np.pi / 180.0
START = nf.Start(
    latitude_deg=40.0,
    longitude_deg=-70.0,
    heading_deg=30.0,
    velocity_n=(1.3, 0.75, 0.0),
    tilt_sd_deg=0.5,
    heading_sd_deg=3.0,
)
LEVEL = ([0.0, 0.0, 0.01], [0.0, 0.0, -9.8])
CRUISE = ([0.0, 0.0, 30.0 * DEG], [1.5, 0.0, 0.0])


def sensors():
    return {
        "compass": nf.Heading(
            rate_hz=4.0, error=nf.GaussMarkov(sd=1.0 * DEG, tau_s=20.0) + nf.White(sd=0.3 * DEG), bias_sd_rad=0.02
        ),
        "dvl": nf.BodyVelocity(rate_hz=4.0, error=nf.White(sd=0.02), lever_arm_b_m=(0.5, 0.0, 0.1), scale_sd=0.01),
        "depth": nf.Depth(rate_hz=1.0, error=nf.Arma(ar=(-0.8,), ma=(0.3,), sd=0.05)),
        "gps": nf.Position(
            rate_hz=1.0, error=nf.GaussMarkov(sd=2.0, tau_s=60.0) + nf.White(sd=1.0), gate_timeout_s=5.0
        ),
    }


def inertial():
    gyro, accel = (
        nf.White(density=1e-4) + nf.RandomWalk(density=1e-6, start_sd=1e-4),
        nf.White(density=1e-3) + nf.RandomWalk(density=1e-5, start_sd=1e-2),
    )
    return nf.Vehicle(imu=nf.Imu(rate_hz=50.0, gyro=gyro, accel=accel), sensors=sensors())


def reckoning():
    kept = {name: sensor for name, sensor in sensors().items() if name in ("depth", "gps")}
    attitude = nf.Heading(rate_hz=4.0, error=nf.GaussMarkov(sd=1.0 * DEG, tau_s=20.0), deviation_sd_rad=(0.02, 0.01))
    return nf.Vehicle(
        nf.DeadReckoning(rate_hz=4.0, attitude=attitude, velocity=nf.BodyVelocity(rate_hz=4.0, scale_sd=0.01)), kept
    )


def inertial_drive(nav):
    return isinstance(nav.vehicle.drive, nf.Imu)


VEHICLES = {"inertial": inertial, "reckoning": reckoning}


def sound(nav):
    """No NaN anywhere, a rotation for attitude, a symmetric positive covariance."""
    state, P = nav.state, nav.filter.P
    assert all(np.isfinite(array).all() for array in (nav.filter.nav, nav.filter.x, P, state.covariance))
    np.testing.assert_allclose(state.C_nb @ state.C_nb.T, np.eye(3), atol=1e-9)
    np.testing.assert_array_equal(P, P.T)
    sd = np.sqrt(np.maximum(np.diag(P), 1e-300))
    # Correlations: unit free, so that a metre and a radian count alike. Rounding of a product of ten thousand updates
    # stays far below 1e-9.
    assert (np.diag(P) >= 0).all()
    assert np.linalg.eigvalsh(P / np.outer(sd, sd)).min() > -1e-9


def run(nav, until_s, begin_s=0.0):
    rate = nav.vehicle.drive.rate_hz
    times = np.arange(round(begin_s * rate) + 1, round(until_s * rate) + 1) / rate
    first, second = LEVEL if inertial_drive(nav) else CRUISE
    nav.step(times, np.tile(first, (len(times), 1)), np.tile(second, (len(times), 1)))


@pytest.fixture(params=VEHICLES)
def nav(request):
    navigator = nf.Navigator(VEHICLES[request.param](), START, nf.Tape())
    run(navigator, 2.0)
    return navigator


def fix(nav, north_m=0.0, height_m=0.0):
    return [nav.state.latitude + north_m / 6.37e6, nav.state.longitude, height_m]


def test_every_reading_has_an_outcome(nav):
    assert nav.correct("sonar", 2.0, 1.0).status == "unknown-sensor"
    assert nav.correct("gps", 2.0, fix(nav)).status == "used"
    assert nav.correct("gps", 2.0, fix(nav)).status == "duplicate"
    assert nav.correct("gps", 1.5, fix(nav)).status == "duplicate"  # older than the last one heard
    assert nav.correct("depth", 1.0, 0.0).status == "too-late"
    assert nav.correct("depth", 2.0 + 5.0, 0.0).status == "ahead"
    assert nav.correct("depth", 2.0, 0.0).accepted
    assert nav.correct("depth", 2.9, 0.0).status == "used"  # up to a second after the last sample of the drive
    assert nav.time_s == 2.9
    residuals = nav.filter.tape.residuals()
    assert [OUTCOMES[code] for code in residuals["gps"].outcome] == ["used", "duplicate", "duplicate"]
    assert [OUTCOMES[code] for code in residuals["depth"].outcome] == ["too-late", "ahead", "used", "used"]
    sound(nav)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("gps", [math.nan, math.nan, math.nan]), ("gps", [math.nan, 1.0, 2.0]), ("gps", [math.inf, 1.0, 2.0]), ("gps", [40.0, -70.0, 0.0]),
        ("gps", [0.7, -1.2]), ("gps", []), ("gps", 0.7), ("gps", [0.7, -1.2, 0.0, 9.0]), ("depth", math.nan), ("depth", math.inf),
        ("depth", -math.inf), ("depth", []), ("depth", [None]),
    ],
)  # fmt: skip
def test_unusable_readings_are_invalid(nav, name, value):
    before = nav.filter.P.copy()
    outcome = nav.correct(name, 2.0, value)
    assert outcome.status == "invalid" and not outcome.accepted and math.isnan(outcome.nis)
    np.testing.assert_array_equal(nav.filter.P, before)
    assert nav.filter.tape.residuals()[name].count("invalid") == 1
    sound(nav)


@pytest.mark.parametrize("sd", [math.nan, -1.0, math.inf, [1.0, 2.0], [math.nan] * 3])
def test_an_unusable_sd_makes_the_reading_invalid(nav, sd):
    assert nav.correct("gps", 2.0, fix(nav), sd=sd).status == "invalid"
    sound(nav)


def test_an_sd_with_the_reading_replaces_that_of_the_model():
    ordinary, sure = (nf.Navigator(inertial(), START) for _ in range(2))
    for navigator, sd in ((ordinary, None), (sure, 0.01)):
        run(navigator, 1.0)
        assert navigator.correct("gps", 1.0, fix(navigator), sd=sd).accepted
    assert sure.state.sd[0] < 0.9 * ordinary.state.sd[0]


@pytest.mark.parametrize("time_s", [math.nan, math.inf, -math.inf])
def test_a_reading_without_a_time_is_invalid(nav, time_s):
    assert nav.correct("depth", time_s, 0.0).status == "invalid"


def test_a_dvl_that_lost_the_bottom_is_not_a_reading():
    nav = nf.Navigator(inertial(), START, nf.Tape())
    run(nav, 1.0)
    for k, value in enumerate(
        ([0.0, 0.0, 0.0], [-32.768] * 3, [math.nan] * 3, [math.inf, 0.0, 0.0], [99.0, -99.0, 88.0])
    ):
        assert nav.correct("dvl", 1.0 + 0.001 * k, value).status == "invalid"
    outcome = nav.correct("dvl", 1.1, [1.5, math.nan, -32.768])
    assert outcome.status == "used" and outcome.dof == 1
    residuals = nav.filter.tape.residuals()["dvl"]
    assert np.isfinite(residuals.value[-1]).tolist() == [True, False, False] and np.isfinite(
        residuals.sd[-1]
    ).tolist() == [
        True,
        False,
        False,
    ]
    wheels = nf.BodyVelocity(rate_hz=4.0, zero_is_invalid=False)
    nav = nf.Navigator(
        nf.Vehicle(imu=nf.Imu(rate_hz=50.0), sensors={"wheels": wheels}),
        dataclasses.replace(START, velocity_n=(0.0, 0.0, 0.0)),
    )
    run(nav, 0.1)
    assert nav.correct("wheels", 0.1, [0.0, 0.0, 0.0]).status == "used"


def test_a_compass_may_bring_more_than_it_needs():
    nav = nf.Navigator(inertial(), START)
    run(nav, 1.0)
    assert nav.correct("compass", 1.0, [0.52]).status == "used"
    assert nav.correct("compass", 1.01, [0.52, 21.0, 7.0, 8.0]).status == "used"
    sound(nav)


def test_gate_rejects_then_widens_after_the_time_out():
    nav = nf.Navigator(inertial(), START, nf.Tape())
    statuses, widened, far = [], [], fix(nav, north_m=500.0)
    for second in range(1, 31):
        run(nav, second, second - 1)
        outcome = nav.correct(
            "gps", second, np.array(far) + 1e-12 * second
        )  # a receiver that says the same for ever is stuck, not rejected
        statuses.append(outcome.status)
        widened.append(outcome.widened)
        sound(nav)
    assert statuses[:5] == ["rejected"] * 5
    assert "used" in statuses and any(widened)
    first = statuses.index("used")
    assert widened[first] and nav.counts["widened"] == sum(widened)
    assert statuses[first + 1 :].count("rejected") <= 2  # the sensor is believed again
    # 500 m off with an sd of 10 m: after it was let in, the state follows the sensor
    assert abs((nav.state.latitude - far[0]) * 6.37e6) < 20.0
    assert nav.filter.tape.residuals()["gps"].count("rejected") == statuses.count("rejected")


def test_widening_with_a_missing_height_invents_no_reading():
    nav = nf.Navigator(inertial(), START)
    for second in range(1, 31):
        run(nav, second, second - 1)
        sd_height = nav.state.sd[2]
        outcome = nav.correct("gps", second, [*fix(nav, north_m=0.0 if second < 2 else 300.0)[:2], math.nan])
        if outcome.widened:
            break
    assert outcome.widened and outcome.dof == 2
    # Horizontal fixes hardly touch the height: an invented reading of it would have brought 10 m down to 2 m.
    assert nav.state.sd[2] > 0.8 * sd_height > 3.0


def test_bad_samples_of_the_drive_are_repaired_or_dropped_and_counted(nav):
    first, second = LEVEL if inertial_drive(nav) else CRUISE
    period = nav.vehicle.drive.period_s
    nav.step(2.0 + period, [math.nan, 0, 0], second)
    nav.step(2.0 + 2 * period, first, [0, math.inf, 0])
    assert nav.counts["bad-sample"] == (
        2 if inertial_drive(nav) else 1
    )  # a lost velocity is no defect of dead reckoning
    nav.step(2.0 + 2 * period, first, second)  # duplicate
    nav.step(1.0, first, second)  # backward
    nav.step(math.nan, first, second)
    nav.step(math.inf, first, second)
    assert nav.counts["backward"] == 4
    nav.step(2.0 + 10 * period, first, second)
    assert nav.counts["gap"] == 1
    assert nav.time_s == 2.0 + 10 * period
    block = np.array([[2.0 + k * period, *first, *second] for k in (11, 9, 12, 12, 13)])
    block[2, 2] = math.nan
    nav.step_samples(block)
    assert nav.counts["backward"] == 6 and nav.time_s == 2.0 + 13 * period
    assert nav.counts["bad-sample"] == (3 if inertial_drive(nav) else 2)
    sound(nav)


def test_a_bad_first_sample_starts_from_what_is_known():
    nav = nf.Navigator(reckoning(), START)
    nav.step(0.25, [math.nan] * 3, [math.nan] * 3)
    assert abs(nav.state.heading - 30.0 * DEG) < 1e-6  # the start's, not north
    np.testing.assert_allclose(nav.state.velocity_n, START.velocity_n, atol=1e-6)
    for increments in (False, True):
        nav = nf.Navigator(nf.Vehicle(imu=nf.Imu(rate_hz=50.0, increments=increments)), START)
        nav.step(0.02, [math.nan] * 3, [math.nan] * 3)
        np.testing.assert_allclose(nav.state.velocity_n, START.velocity_n, atol=2e-3)  # gravity to 0.1 m/s^2 for 20 ms


@pytest.mark.parametrize("increments", [False, True])
def test_a_first_sample_at_the_start_moves_nothing(increments):
    nav = nf.Navigator(nf.Vehicle(imu=nf.Imu(rate_hz=50.0, increments=increments)), START)
    scale = 0.02 if increments else 1.0
    nav.step(0.0, np.array(LEVEL[0]) * scale, np.array(LEVEL[1]) * scale)
    np.testing.assert_allclose(nav.state.velocity_n, START.velocity_n, atol=1e-12)


def test_absurd_values_leave_no_nan(nav):
    for k, value in enumerate((1e5, -1e30, 1e200, 1.7e308)):
        nav.step(2.0 + 0.02 * (k + 1), [value, 0.0, 0.0], [0.0, value, 0.0])
        sound(nav)


@pytest.mark.parametrize("jump_s", [30.0, 3600.0, 1e6, 1.7e9])
def test_a_jump_of_the_clock_leaves_no_nan(nav, jump_s):
    first, second = LEVEL if inertial_drive(nav) else CRUISE
    nav.step(2.0 + jump_s, first, second)
    sound(nav)
    run(nav, 3.0, 2.0)
    nav.correct("depth", 2.0 + jump_s, 0.0)
    sound(nav)


def test_a_state_that_goes_back_from_a_reading_ahead_keeps_a_covariance():
    """Found where stamps saw: what a large tilt adds to the vertical velocity was taken off for a negative time."""
    sensors = {"compass": nf.Heading(rate_hz=8, error=nf.White(sd=0.02)), "depth": nf.Depth(rate_hz=1)}
    nav = nf.Navigator(
        nf.Vehicle(imu=nf.Imu(rate_hz=100, gyro=nf.White(density=1e-4)), sensors=sensors),
        nf.Start(latitude_deg=45.0, longitude_deg=-4.0, tilt_sd_deg=10.0),
    )
    for k in range(1, 121):
        nav.step(0.01 * k, (0.0, 0.0, 0.0), (0.0, 0.0, -9.806))
        if k == 100:
            assert nav.correct("depth", 1.9, 0.0).status == "used"
    assert nav.correct("compass", 1.2, 0.0).status == "used"
    assert np.linalg.eigvalsh(nav.state.covariance)[0] > 0.0


def test_readings_before_the_first_sample():
    for build in VEHICLES.values():
        nav = nf.Navigator(build(), START, nf.Tape())
        assert nav.correct("gps", -5.0, fix(nav)).status == "too-late"
        place = fix(nav)
        place[2] += 0.01  # the same to the bit would be that of a receiver that is stuck
        assert nav.correct("gps", 0.0, place).status == "used"
        assert nav.correct("depth", 0.5, 0.0).status == "used"
        assert nav.correct("depth", 100.0, 0.0).status == "ahead"
        run(nav, 1.0)
        sound(nav)


def test_nothing_uncertain_is_no_division_by_zero():
    sure = dataclasses.replace(START, position_sd_m=0.0, velocity_sd_m_s=0.0, tilt_sd_deg=0.0, heading_sd_deg=0.0)
    exact = nf.White(sd=0.0)
    vehicle = nf.Vehicle(
        imu=nf.Imu(rate_hz=50.0, gyro=exact, accel=exact),
        sensors={"depth": nf.Depth(error=exact), "gps": nf.Position(error=exact)},
    )
    nav = nf.Navigator(vehicle, sure, nf.Tape())
    run(nav, 1.0)
    for k, value in enumerate((0.0, -nav.state.height, 1.0)):
        assert nav.correct("depth", 1.0 + 0.01 * k, value).status in ("used", "rejected")
        assert nav.correct("gps", 1.0 + 0.01 * k, fix(nav, height_m=value)).status in ("used", "rejected")
        sound(nav)


def noisy_mission(nav, seconds, seed, defects=0.0):
    """Events of a wandering vehicle; a share of them is rubbish."""
    rng, rate = np.random.default_rng(seed), nav.vehicle.drive.rate_hz
    base = np.concatenate(LEVEL if inertial_drive(nav) else CRUISE)
    spread = np.array([0.02] * 3 + [0.05] * 3) if inertial_drive(nav) else np.array([0.01] * 3 + [0.03] * 3)
    events = [(k / rate, DRIVE, base + spread * rng.normal(size=6)) for k in range(1, int(seconds * rate) + 1)]
    place = START.state
    for name, sensor in nav.vehicle.sensors.items():
        for k in range(1, int(seconds * sensor.rate_hz)):
            value = {
                "compass": [0.52],
                "dvl": [1.5, 0.0, 0.0],
                "depth": [0.0],
                "gps": [place.latitude, place.longitude, 0.0],
            }[name]
            size = {"compass": 0.01, "dvl": 0.02, "depth": 0.05, "gps": np.array([3e-7, 3e-7, 2.0])}[name]
            events.append((k / sensor.rate_hz + 0.003, name, np.array(value) + size * rng.normal(size=len(value))))
    events.sort(key=lambda event: event[0])
    rubbish = [math.nan, math.inf, -math.inf, 0.0, -32.768, 1e9, -9999.0]
    for k in np.flatnonzero(rng.random(len(events)) < defects):
        time_s, name, value = events[k]
        if rng.random() < 0.7:
            value = value.copy()
            value[rng.integers(len(value))] = rng.choice(rubbish)
        else:
            time_s = rng.choice([math.nan, time_s - 1.0, time_s, time_s + 0.05, -1.0, time_s + 3.0])
        events[k] = time_s, name, value
    return [Event(name, time_s, value, time_s, time_s) for time_s, name, value in events]


def feed(nav, events):
    assert {outcome.status for outcome in one_by_one(nav, events)} <= set(OUTCOMES)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("build", VEHICLES.values(), ids=VEHICLES.keys())
def test_rubbish_leaves_no_nan_anywhere(build, seed):
    nav = nf.Navigator(build(), START, nf.Tape())
    events = noisy_mission(nav, 40.0, seed, defects=0.1)
    feed(nav, events)
    sound(nav)
    residuals = nav.filter.tape.residuals()
    assert sum(len(r.time_s) for r in residuals.values()) == sum(event.sensor != DRIVE for event in events)
    smoothed = []
    smooth_rows(
        nav.filter.tape, lambda _, states, means, covs, __: smoothed.extend(np.isfinite([means.sum(), covs.sum()]))
    )
    assert smoothed and all(smoothed)


@pytest.mark.parametrize("build", VEHICLES.values(), ids=VEHICLES.keys())
def test_covariance_stays_positive_for_minutes(build):
    nav = nf.Navigator(build(), START)
    feed(nav, noisy_mission(nav, 240.0, 1))
    sound(nav)


@pytest.mark.slow
@pytest.mark.parametrize("build", VEHICLES.values(), ids=VEHICLES.keys())
def test_covariance_stays_positive_for_twelve_hours(build):
    nav = nf.Navigator(build(), START)
    for hour in range(12):
        events = noisy_mission(nav, 3600.0, hour)
        feed(nav, [event._replace(time_s=event.time_s + 3600.0 * hour) for event in events])
        sound(nav)


@pytest.mark.parametrize("build", VEHICLES.values(), ids=VEHICLES.keys())
def test_blocks_and_single_samples_agree_bit_for_bit(build):
    single, blocks = (nf.Navigator(build(), START, nf.Tape()) for _ in range(2))
    events = noisy_mission(single, 20.0, 5, defects=0.02)
    feed(single, events)
    waiting = []
    for name, time_s, value, *_ in [*events, Event("", None, None, 0.0, 0.0)]:
        if name == DRIVE:
            waiting.append([time_s, *value])
            continue
        if waiting:
            blocks.step_samples(np.array(waiting))
            waiting = []
        if name:
            blocks.correct(name, time_s, value)
    same_runs.assert_same_bits(single, blocks)
    assert single.filter.tape.row_times == blocks.filter.tape.row_times
    assert len(single.filter.tape.records) == len(blocks.filter.tape.records)


@pytest.mark.parametrize("build", VEHICLES.values(), ids=VEHICLES.keys())
def test_a_spooled_tape_smooths_to_the_same_bits_and_thinning_changes_nothing(build, monkeypatch):
    monkeypatch.setattr(
        "navfilter.filter.records.RecordStore.CHUNK", 1 << 11
    )  # 16 KiB, so that a short run has many chunks
    results = []
    for memory_bytes, rate in ((1 << 30, None), (0, None), (0, 2.0)):
        tape = nf.Tape(output_rate_hz=rate, memory_bytes=memory_bytes)
        nav = nf.Navigator(build(), START, tape)
        feed(nav, noisy_mission(nav, 20.0, 6))
        if memory_bytes == 0:
            assert sum(chunk is None for chunk in tape.records._chunks) > 3  # really in the file
        rows = {}
        smooth_rows(tape, lambda begin, states, means, covs, _, rows=rows, tape=tape: rows.update(
            (tape.row_times[begin + i], np.concatenate([state, mean, cov.ravel()]))
            for i, (state, mean, cov) in enumerate(zip(states, means, covs, strict=True))
        ))  # fmt: skip
        results.append(rows)
    memory, spooled, thinned = results
    assert memory.keys() == spooled.keys() and thinned.keys() < memory.keys() and len(thinned) >= 20
    for time_s, row in memory.items():
        np.testing.assert_array_equal(spooled[time_s], row)
    for time_s, row in thinned.items():
        np.testing.assert_array_equal(row, memory[time_s])


def test_a_tape_without_records_cannot_be_smoothed():
    with pytest.raises(ValueError, match="smooth=True"):
        smooth_rows(nf.Tape(smoothable=False), lambda *_: None)


def test_rest_is_detected_and_counts_as_zero_velocity():
    vehicle = nf.Vehicle(imu=nf.Imu(rate_hz=50.0), sensors={"rest": nf.ZeroVelocity(rate_hz=1.0)})
    still = dataclasses.replace(START, velocity_n=(0.0, 0.0, 0.0))
    for increments in (False, True):
        nav = nf.Navigator(dataclasses.replace(vehicle.drive, increments=increments) and nf.Vehicle(
            imu=dataclasses.replace(vehicle.drive, increments=increments), sensors=vehicle.sensors), still, nf.Tape())  # fmt: skip
        scale, rng = (0.02 if increments else 1.0), np.random.default_rng(0)
        n = 500
        rates, forces = 1e-3 * rng.normal(size=(n, 3)), 1e-2 * rng.normal(size=(n, 3)) + LEVEL[1]
        nav.step(np.arange(1, n + 1) / 50.0, scale * rates, scale * forces)
        assert nav.filter.tape.residuals()["rest"].count("used") == 10
        assert nav.state.sd[3] < 0.02
        rates[:, 2] += 0.3 * np.sin(np.arange(n) / 10.0)
        nav.step(10.0 + np.arange(1, n + 1) / 50.0, scale * rates, scale * forces)
        assert nav.filter.tape.residuals()["rest"].count("used") == 10


def test_gaps_leave_the_uncertainty_that_they_should():
    # unknown forces, of turns of three seconds; the velocity and the heading between two that are known, a bridge of
    # 0.05 m/s and 0.35 rad a root s
    bridge, pushed_m = math.sqrt(20.0**3 / 12.0), 0.3 * math.sqrt(3.0 * 20.0**3 / 3.0)
    for build, forces_m, wander, turn in ((inertial, pushed_m, 0.0, 0.0), (reckoning, 0.0, 0.05, 0.35)):
        nav = nf.Navigator(
            build(),
            dataclasses.replace(START, position_sd_m=0.1, velocity_sd_m_s=0.001, tilt_sd_deg=0.01, heading_sd_deg=0.01),
        )
        run(nav, 1.0)
        before = nav.state.sd[0]
        run(nav, 21.0 + 2.0 * nav.vehicle.drive.period_s, 21.0)  # the second sample confirms the stamp of the first
        # what may have happened unseen, and little else; nobody said how fast it can be: 3 m/s, or twice what it did
        speed = float(np.linalg.norm(nav.state.velocity_n))
        expected_m = math.hypot(forces_m, bridge * math.hypot(wander, turn * speed))
        expected_m = min(expected_m, 20.0 * 0.5 * (max(3.0, 2.0 * speed) + speed))
        assert 0.9 * expected_m < math.sqrt(nav.state.sd[0] ** 2 - before**2) < 1.5 * expected_m + 0.5


def test_navigator_refuses_what_is_no_vehicle():
    with pytest.raises(ValueError, match="vehicle must be a Vehicle, found a dict"):
        nf.Navigator({}, START)


def test_dead_reckoning_by_a_magnetic_compass_applies_the_declination():
    compass = nf.Heading(rate_hz=4.0, magnetic=True, declination_rad=0.2)
    nav = nf.Navigator(nf.Vehicle(nf.DeadReckoning(rate_hz=4.0, attitude=compass)), START)
    nav.step(0.25, [0.0, 0.0, 0.3], [1.0, 0.0, 0.0])
    assert nav.state.heading == pytest.approx(0.5)
    with pytest.raises(ValueError, match="must give a heading, found a magnetometer"):
        nf.DeadReckoning(rate_hz=4.0, attitude=nf.Heading(magnetometer=True))


def test_a_vehicle_survives_pickling():
    again = pickle.loads(pickle.dumps(inertial()))
    assert again.sensors["gps"] == inertial().sensors["gps"] and again.drive == inertial().drive


def test_the_pose_is_the_state_in_plain_numbers():
    vehicle = nf.Vehicle(imu=nf.Imu(rate_hz=100), sensors={"depth": nf.Depth(rate_hz=1)})
    nav = nf.Navigator(vehicle, nf.Start(latitude_deg=45.0, longitude_deg=-4.0, roll_deg=3.0, heading_deg=250.0))
    for k in range(1, 40):
        nav.step(0.01 * k, (0.1, -0.2, 0.3), (0.5, 0.1, -9.806))
    pose, state = nav.pose, nav.state
    assert pose == state.pose and pose.time_s == state.time_s == 0.39
    assert (pose.latitude, pose.longitude, pose.height) == (state.latitude, state.longitude, state.height)
    np.testing.assert_array_equal(pose.velocity_n, state.velocity_n)
    np.testing.assert_array_equal(np.reshape(pose.C_nb, (3, 3)), state.C_nb)
    assert pose.heading == pytest.approx(state.roll_pitch_heading[2], rel=0, abs=1e-15)
    nav.step(0.4, (0.1, -0.2, 0.3), (0.5, 0.1, -9.806))
    assert nav.pose != pose  # the one before stays what it was
