"""Software to compare with, given the work of the standard hour: filterpy and python-ins.

filterpy's `KalmanFilter` predicts and updates with matrices of the same size as ours (no mechanisation, no Jacobians:
its best case), its `rts_smoother` runs over the steps that it kept. python-ins integrates the same inertial samples
(strapdown alone) and runs its feedback filter, 15 states, with a body velocity at 4 Hz. Neither is made for what we do;
it is what they offer.
"""

from __future__ import annotations

import time
from typing import Any, NamedTuple

import numpy as np
from harness import Array, Clock

import navfilter as nf


class Filterpy(NamedTuple):
    """Seconds of every `predict` and `update`, shapes (n,), and of the smoother per step that it is given."""

    predict: Array
    update: Array
    smoother: float


def filterpy_times(states: int, steps: int, every: int, clock: Clock = time.perf_counter) -> Filterpy:
    """Time filterpy at a number of states, a correction with one component at every so many steps.

    The first ten steps are not counted. The smoother gets one step per correction.
    """
    from filterpy.kalman import KalmanFilter

    rng = np.random.default_rng(0)
    kf = KalmanFilter(dim_x=states, dim_z=1)
    kf.x, kf.F = np.zeros(states), np.eye(states) + 0.001 * rng.normal(size=(states, states))
    kf.Q, kf.H, kf.R = 1e-4 * np.eye(states), rng.normal(size=(1, states)), np.eye(1)
    predict, update, means, covariances, z = [], [], [], [], np.zeros(1)
    for k in range(steps):
        began = clock()
        kf.predict()
        predict.append(clock() - began)
        if k % every == 0:
            began = clock()
            kf.update(z)
            update.append(clock() - began)
            means.append(kf.x.copy())
            covariances.append(kf.P.copy())
    began = clock()
    kf.rts_smoother(np.array(means), np.array(covariances))
    return Filterpy(np.array(predict[10:]), np.array(update[2:]), (clock() - began) / len(means))


def pyins_input(samples: Array, start: nf.Start) -> tuple[Any, Any]:
    """Inertial samples (time, rates, forces; shape (n, 7)) and a start as python-ins takes them."""
    import pandas as pd
    from pyins import util

    columns = util.GYRO_COLS + util.ACCEL_COLS
    imu = pd.DataFrame(samples[:, 1:], index=pd.Index(samples[:, 0], name="time"), columns=columns)
    place = (start.latitude_deg, start.longitude_deg, start.height_m)
    angles = (start.roll_deg, start.pitch_deg, start.heading_deg)
    return imu, pd.Series([*place, *start.velocity_n, *angles], index=util.TRAJECTORY_COLS, name=float(samples[0, 0]))


def pyins_strapdown(samples: Array, start: nf.Start, clock: Clock = time.perf_counter) -> float:
    """Seconds per inertial sample of python-ins's strapdown alone."""
    from pyins import strapdown

    imu, pva = pyins_input(samples, start)
    strapdown.Integrator(pva).integrate(strapdown.compute_increments_from_imu(imu.iloc[:100], "rate"))  # compile
    began = clock()
    strapdown.Integrator(pva).integrate(strapdown.compute_increments_from_imu(imu, "rate"))
    return (clock() - began) / len(samples)


def pyins_filter(samples: Array, start: nf.Start, step_s: float, clock: Clock = time.perf_counter) -> Array:
    """Seconds per inertial sample of python-ins's feedback filter, one figure per correction (25 samples).

    Parameters
    ----------
    samples : ndarray, shape (n, 7)
    start : Start
    step_s : float
        Longest step of its covariance [s]; 0.01 is one sample at 100 Hz, as a vehicle would have to call it.
    clock : callable
    """
    from pyins import filters, inertial_sensor, measurements, sim, strapdown

    class Stamped(measurements.BodyVelocity):
        """A body velocity that notes when it is asked for."""

        def compute_matrices(self, *arguments: Any) -> Any:
            stamps.append(clock())
            return super().compute_matrices(*arguments)

    stamps: list[float] = []
    imu, pva = pyins_input(samples, start)
    increments = strapdown.compute_increments_from_imu(imu, "rate")
    integrator = strapdown.Integrator(pva)
    integrator.integrate(increments)  # compiles, and gives the velocities to correct with
    velocity = sim.generate_body_velocity_measurements(integrator.trajectory.iloc[25::25], 0.01, 0)
    bias = inertial_sensor.EstimationModel(bias_sd=np.full(3, 1e-4), noise=1e-5, bias_walk=1e-7)
    given = [Stamped(velocity, 0.01)]
    filters.run_feedback_filter(pva, 10.0, 0.5, 1.0, 5.0, increments, bias, bias, measurements=given, time_step=step_s)
    return np.diff(stamps) / 25.0
