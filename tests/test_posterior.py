"""Exactness: filter and smoother are the Gaussian posterior of their own linearised model.

Every run is captured as its chain ``e- = Phi e + w, res = H e- + v, e+ = G (e- - K res)`` of errors (true minus
estimated), G the reset of the attitude. The whole chain is then one Gaussian vector, conditioned in one piece on all
its residuals, or walked sample by sample.
"""

import types

import naive
import numpy as np
import pytest
from dense_posterior import (
    ARMA,
    Capture,
    Unknowns,
    ahrs_vehicle,
    assert_same,
    beams_vehicle,
    drifting_vehicle,
    drive_through,
    inertial_vehicle,
    iron_vehicle,
    ranging_vehicle,
    reckoning_vehicle,
    resting_vehicle,
    start,
    uncalibrated,
    usbl_vehicle,
    water_vehicle,
    wheeled_vehicle,
)
from filterpy.kalman import KalmanFilter

import navfilter as nf
from navfilter.filter import filter as engine

CASES = {
    "inertial": (inertial_vehicle, 6.0),
    "reckoning": (reckoning_vehicle, 9.0),
    "drifting": (drifting_vehicle, 9.0),
    "inertial, uncalibrated": (uncalibrated(inertial_vehicle), 3.0),
    "reckoning, uncalibrated": (uncalibrated(reckoning_vehicle), 9.0),
    "water": (water_vehicle, 3.0),
    "iron": (iron_vehicle, 3.0),
    "beams": (beams_vehicle, 3.0),
    "ranges": (ranging_vehicle, 3.0),
    "usbl": (usbl_vehicle, 3.0),
    "ahrs": (ahrs_vehicle, 2.5),
    "wheels": (wheeled_vehicle, 3.0),
    "at rest": (resting_vehicle, 3.0),
    "water, white": (lambda arma=True: water_vehicle(arma, white=True), 3.0),
}


@pytest.mark.parametrize("case", CASES)
def test_filter_and_smoother_equal_the_dense_posterior(case, monkeypatch):
    build, seconds = CASES[case]
    capture = Capture(monkeypatch, build(), start())
    drive_through(capture.nav, seconds, seed=1)
    rows, smoothed = capture.rows(), capture.smoothed()
    corrected = [k for k, step in enumerate(capture.steps, 1) if step.H is not None]
    assert len(corrected) > 12
    assert (
        max(np.abs(capture.steps[k - 1].G - np.eye(capture.n)).max() for k in corrected) > 0.01
    )  # resets worth the name
    unknowns = Unknowns(capture.steps, capture.P0, dict(rows))
    dense = unknowns.posterior(dict(rows))
    for count, P in rows:  # by 1.1e-9 where noise of a large tilt is added and taken off again: doubles round
        assert_same(smoothed[count], dense[count], np.sqrt(np.diag(P)), 2e-9)
    first = unknowns.seen[0][0]  # before it there is nothing to condition on
    for count, P in [row for row in rows[:: max(1, len(rows) // 6)] if row[0] >= first]:
        past = unknowns.posterior({count}, upto=count)[count]
        assert_same((np.zeros(capture.n), P), past, np.sqrt(np.diag(P)), 1e-9)


@pytest.mark.parametrize("case", CASES)
def test_smoother_equals_rauch_tung_striebel_at_every_sample(case, monkeypatch):
    build, seconds = CASES[case]
    capture = Capture(monkeypatch, build(arma=False), start())
    drive_through(capture.nav, seconds if case.startswith("reckoning") else 2.0, seed=2)
    chain = capture.samples
    ends, at = {0: 0}, 0
    still, links, after = np.eye(capture.n), [], [0]
    for s in chain:
        links.append((s.Phi, s.Q, s.H, s.R, s.res, s.G if s.G is not None else still))
        if s.U is not None:  # what is only considered walks
            links.append((still, s.U, None, None, None, still))
        after.append(len(links))
    means, covariances = naive.rts(links, capture.P0)
    # where in the chain of samples each record of the tape ends: compound transitions agree there
    compound = np.eye(capture.n)
    records = iter(capture.steps)
    record = next(records)
    for k, step in enumerate(chain, 1):
        compound = step.Phi @ compound
        if (
            record is not None
            and np.allclose(compound, record.Phi, rtol=0, atol=1e-12)
            and (step.H is None) == (record.H is None)
        ):
            at += 1
            ends[at], compound, record = k, np.eye(capture.n), next(records, None)
    assert record is None
    smoothed = capture.smoothed()
    for count, P in capture.rows():
        k = after[ends[count]]
        assert_same(smoothed[count], (means[k], covariances[k]), np.sqrt(np.diag(P)), 1e-9)


def test_filterpy_agrees_in_a_linear_case(monkeypatch):
    """No attitude error, so nothing is reset and the chain is plainly linear; filterpy runs it open loop."""
    still = nf.White(sd=0.0)
    vehicle = nf.Vehicle(
        imu=nf.Imu(rate_hz=10.0, gyro=still, accel=nf.White(density=0.05) + nf.RandomWalk(density=0.01, start_sd=0.05)),
        sensors={
            "depth": nf.Depth(rate_hz=2.0, error=nf.GaussMarkov(sd=0.3, tau_s=4.0) + nf.White(sd=0.1)),
            "gps": nf.Position(rate_hz=1.0, error=nf.Arma(**ARMA, sd=0.3) + nf.White(sd=0.5)),
        },
    )
    # A frozen attitude: the Earth's rate and the curvature of its surface would tilt n under a moving vehicle by 1e-7
    # rad.
    capture = Capture(monkeypatch, vehicle, start(tilt_sd_deg=0.0, heading_sd_deg=0.0))
    capture.freeze_attitude()
    drive_through(capture.nav, 8.0, seed=3)
    n = capture.n
    kf = KalmanFilter(dim_x=n, dim_z=3)
    kf.x, kf.P = np.zeros(n), capture.P0.copy()
    xs, Ps, Fs, Qs = [kf.x.copy()], [kf.P.copy()], [np.eye(n)], [np.zeros((n, n))]
    for step in capture.steps:
        kf.predict(F=step.Phi, Q=step.Q)
        if step.H is not None:
            assert np.array_equal(step.G, np.eye(n))
            kf.dim_z = len(step.res)
            kf.update(step.res + step.H @ kf.x, R=step.R, H=step.H)
        xs.append(kf.x.copy())
        Ps.append(kf.P.copy())
        Fs.append(step.Phi)
        Qs.append(step.Q)
    # the method uses Fs[k + 1] and Qs[k + 1] for the step from k to k + 1
    sxs, sPs, _, _ = kf.rts_smoother(
        np.array(xs), np.array(Ps), Fs=Fs, Qs=Qs, inv=lambda P: np.linalg.pinv(P, hermitian=True)
    )
    smoothed = capture.smoothed()
    for count, P in capture.rows():
        sd = np.sqrt(np.diag(P))
        assert_same((np.zeros(n), P), (np.zeros(n), Ps[count]), sd, 1e-9)
        assert_same(smoothed[count], (sxs[count] - xs[count], sPs[count]), sd, 1e-9)


def test_the_capture_is_the_run_itself(monkeypatch):
    """What the other tests capture is what an untouched navigator does, up to rounding of the compound."""
    tape = nf.Tape()
    nav = nf.Navigator(inertial_vehicle(), start(), tape)
    drive_through(nav, 3.0, seed=4)
    capture = Capture(monkeypatch, inertial_vehicle(), start())
    drive_through(capture.nav, 3.0, seed=4)
    assert len(tape.records) == len(capture.steps)
    assert isinstance(capture.nav.state, nf.NavState) and not isinstance(engine.kalman, types.ModuleType)
    sd = nav.state.sd
    np.testing.assert_allclose(nav.state.minus(capture.nav.state) / sd, 0.0, atol=1e-10)
    np.testing.assert_allclose(
        nav.state.covariance / np.outer(sd, sd), capture.nav.state.covariance / np.outer(sd, sd), atol=1e-10
    )
