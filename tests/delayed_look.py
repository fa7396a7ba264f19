"""Readings of a sensor whose lever arm and clock are states, as NumPy: a twin of
`navfilter.kernels.delayed_state.delayed_reading`.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from navfilter.kernels import consistency, delayed_state, measurement, strapdown
from navfilter.kernels.consistency import WINDOW_S
from navfilter.kernels.delayed_state import STEP
from navfilter.models.sensors import Sensor
from navfilter.models.start import Start

__all__ = ["Sight"]

Array = NDArray[np.float64]


class Sight:
    """The twin for one sensor.

    Parameters
    ----------
    sensor : Sensor
    start : Start

    Attributes
    ----------
    arm, clock : bool
        Which of them are states; with a clock it needs to know how the vehicle has moved.
    facts : ndarray
        See ``navfilter.kernels.delayed_state``.
    """

    def __init__(self, sensor: Sensor, start: Start) -> None:
        self.kernel, self.axes = sensor.kernel, sensor.axes
        self.clock, self.arm = sensor.time_offset_sd_s > 0.0, any(sensor.lever_arm_sd_m)
        self._constants = sensor.constants(start)
        self._turns = sensor.needs_rate or self.arm
        self._by_arm = np.zeros((self._constants.size, 3))
        self._inner, self._ends = np.zeros((self.axes, 9 + len(sensor.parameters()))), np.zeros(self.axes)
        self._then, self._turn, self._slope, self._B = np.empty(17), np.empty(6), np.empty((2, 9)), np.empty((9, 9))
        if self.arm:
            for i, e in enumerate(np.eye(3)):
                self._by_arm[:, i] = self._constants_at(sensor, start, e) - self._constants
        self._steps = STEP * np.ascontiguousarray(self._by_arm.T)
        known = self.arm, self.clock, self._turns, max(1.0, delayed_state.LEFT_S * sensor.rate_hz)
        self.facts = np.concatenate([np.array(known, dtype=np.float64), self._by_arm.ravel()])

    @staticmethod
    def _constants_at(sensor: Any, start: Start, off: Array) -> Array:
        """The kernel's constants of a sensor that stands `off` from where it is."""
        arm = tuple(float(a + e) for a, e in zip(sensor.lever_arm_b_m, off, strict=True))
        return np.asarray(replace(sensor, lever_arm_b_m=arm).constants(start))

    def look(
        self,
        z: Array,
        nav: Array,
        rate: Array,
        par: Array,
        moved: tuple[Array, float],
        since_s: float,
        outputs: Array,
        drive: tuple[Array, Array],
        variances: tuple[float, Array],
        into: tuple[Array, Array, Array, Array],
    ) -> None:
        """Fill residual and Jacobian as the kernels do, see `navfilter.kernels.measurement`.

        Parameters
        ----------
        z, nav, rate, par : ndarray
            As for a kernel; `par` ends with the states of lever arm and clock.
        moved : (ndarray, float)
            How the vehicle has moved of late, and gravity, see `Mechanisation.motion`.
        since_s : float
            How much later than the stamp it is now [s].
        outputs : ndarray, shape (6, k)
            Rows by which the drive's states make the errors of its six values.
        drive : (ndarray, ndarray)
            Its memory, and (6, k + 1) with the white variances of its values in the last column.
        variances : (float, ndarray)
            Of the clock [s^2], and of the acceleration, see ``consistency.acceleration_covariance``.
        into : tuple of ndarray, shapes (axes, k), (axes, 9 + states), (axes,), (axes, axes)
            Receive the derivatives with respect to the drive's states (a bias bends the way back), those of the kernel,
            and the residual; the white covariance grows by what the clock's error does beyond that.
        """
        H, near, res, R = into
        own = par.size - 3 * self.arm - self.clock
        constants = self._constants + self._by_arm @ par[own : own + 3] if self.arm else self._constants
        inner, kind = self._inner, par[:own]
        if self.clock:
            late_s, now = since_s + float(par[-1]), nav
            slope_s = delayed_state.slope_window_s(variances[0])
            given = self._then, self._turn, self._slope, self._B
            over_s = measurement.earlier(nav, *moved, late_s, WINDOW_S, slope_s, *given)
            nav, rate = self._then, self._turn[:3]
        self.kernel(z, nav, rate, kind, constants, inner, res)
        near[:, : 9 + own] = inner
        if self.clock:
            near[:, :9] = inner[:, :9] @ self._B
            near[:, -1] = -(inner[:, :9] @ self._slope[0])
            if moved[1]:
                H[:] = inner[:, :9] @ by_drive(now, nav, self._B, late_s, outputs)
        # what is not read has slopes, too: by how much it is known is asked, see `consistency.limit_unread_slopes`
        whole, base, ends = np.where(np.isnan(z), 0.0, z), np.empty_like(res), self._ends
        if self.arm:
            told = self._turn[:3].copy()
            if not self.clock:
                delayed_state.mean_rate(moved[0], told)
            steady, drv = nav.copy(), drive[0]
            if not drv[strapdown.INERTIAL]:
                # the attitude is a reading: what it errs by is in the position, too, see ``strapdown._steady``
                steady[6:15] = drv[strapdown.STEADY_C : strapdown.STEADY_C + 9]
            self.kernel(whole, steady, told, kind, constants, inner, base)
            near[:, 9 : 9 + own] = inner[:, 9:]
            for i in range(3):
                self.kernel(whole, steady, told, kind, constants + self._steps[i], inner, ends)
                near[:, 9 + own + i] = (base - ends) / STEP
        if self.clock and self._turns:
            self.kernel(whole, nav, rate, kind, constants, inner, base)
            self.kernel(whole, nav, rate + STEP * self._turn[3:], kind, constants, inner, ends)
            near[:, -1] -= (base - ends) / STEP
        if self.clock:
            consistency.discount_clock(
                inner, self._slope, self._then, *drive, over_s, moved[1], *variances, self.facts[3], near, R
            )


def by_drive(now: Array, then: Array, B: Array, late_s: float, outputs: Array) -> Array:
    """What errors of rates and forces do to a state that is carried back by them, shape (9, k).

    Parameters
    ----------
    now, then : ndarray, shape (17,)
    B : ndarray, shape (9, 9)
        As ``measurement.earlier`` fills it; it holds what the forces have gathered.
    late_s : float
    outputs : ndarray, shape (6, k)
    """
    middle = 0.5 * (now[6:15] + then[6:15]).reshape(3, 3)
    rates, forces = middle @ outputs[:3], middle @ outputs[3:]
    by = np.empty((9, outputs.shape[1]))
    # a tilt that grows on the way back turns the forces: half of what the whole of it would do, a third to the place
    turned = B[3:6, 6:] @ rates
    by[:3] = -0.5 * late_s**2 * (forces + turned / 3.0)
    by[3:6], by[6:] = late_s * (forces + 0.5 * turned), late_s * rates
    return by
