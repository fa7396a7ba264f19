"""A watch over the samples of an inertial unit, axis by axis, and what follows for the filter.

The kernel `navfilter.kernels.imu_checks.check_samples` finds what the samples say of themselves. An axis that is worth
nothing is left out: what is known without it takes its place, with the noise that the vehicle's description gives to
what is unknown (``gap_rate_sd``, ``gap_force_sd``), and the covariance takes what the wrong samples may have done since
they began. Attitude then comes from the compass, and from gravity where the accelerometers still work; velocity from
the DVL. That is dead reckoning, by the same filter.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from navfilter.faults import settings
from navfilter.filter.actions import Action, AxisCondition, Correct, Count, Fold, Inflate, Reweigh
from navfilter.filter.filter_memory import FilterMemory
from navfilter.filter.monitor import FilterState
from navfilter.kernels import imu_checks as kernel
from navfilter.kernels import strapdown
from navfilter.models.error_models import ErrorModel, Sum
from navfilter.models.mechanisation import Mechanisation
from navfilter.models.state import turn_to_down

Array = NDArray[np.float64]
#: In words, by the kernel's codes.
CONDITIONS = (
    *("good", "noisy", "stuck", "dead", "saturated", "erratic", "wrong-unit"),
    *("gravity", "free-fall", "swapped", "wrong-unit", "contradicted", "silent"),
)
#: Those of an axis whose samples are used.
USED = CONDITIONS[: kernel.NOISY + 1]
#: Counters: conditions that began, by axis, and spikes.
COUNTED = (*dict.fromkeys(CONDITIONS[1:]), "spike")
TILTS = slice(kernel.TILTED, kernel.TILTED + 2)
#: A reading at the end of the range, short of it by rounding.
RANGE_END = 0.999


class ImuMonitor:
    """Knows an inertial unit's description; all that it remembers stands in `FilterMemory.watch`.

    Parameters
    ----------
    drive : Mechanisation
        Another than an inertial one is not watched here: its samples are those of sensors.
    """

    def __init__(self, drive: Mechanisation) -> None:
        self.active, self.axes, self._feels = drive.inertial, drive.axis_names, drive.feels
        self._period_s, self._increments = drive.period_s, bool(getattr(drive, "increments", False))
        self.limits = np.zeros(0)
        if not self.active:
            return
        rate_sd, force_sd = drive.gap_rate_sd, drive.gap_force_sd  # type: ignore[attr-defined]
        self._unseen = np.repeat([rate_sd, force_sd], 3)
        per = self._period_s if self._increments else 1.0
        self.limits = RANGE_END * drive.limits() / per

    def expected(self, drive: Mechanisation, white: Array) -> Array:
        """By how much samples are to differ from one to the next: standard deviation of the white noise whose second
        differences are as large as those of an axis' errors. Quick ones may be no white noise of their own; of slow
        ones alone nothing is expected, for how the vehicle moves is more.

        Parameters
        ----------
        drive : Mechanisation
            With the error models in force.
        white : ndarray, shape (6,)
            White variance of a sample.
        """
        if not self.active:
            return np.sqrt(white)
        return np.sqrt(white + np.array([_quick(model, self._period_s) for model in drive.models]) / settings.WHITE)

    def initial_memory(self) -> Array:
        """What it remembers before the first sample."""
        w = np.zeros((kernel.UNIT + 1, kernel.COLUMNS))
        w[:6, kernel.REPEATS], w[:6, kernel.QUANTUM] = 1.0, np.inf
        if not self._feels:
            w[:6, [kernel.CODE, kernel.HEEDED]] = kernel.SATURATED
        return w if self.active else w[:0]

    def check_samples(self, samples: Array, w: Array, sd: Array) -> int:
        """How many samples may be taken before something has to be heeded; bad axes are replaced in them.

        Parameters
        ----------
        samples : ndarray, shape (n, 7)
            Seconds since the one before, six values.
        w : ndarray
            What is remembered.
        sd : ndarray, shape (6,)
            White standard deviations of one sample by the description.
        """
        return kernel.check_samples(samples, w, sd, self.limits, self._period_s, self._increments)

    def replace_missing(self, samples: Array, memory: FilterMemory, said_s: float) -> Iterator[Action]:
        """Values for samples that are missing: no rate, and the force at rest. No axis is good until it has been heard
        again for ``RECOVERS_S``.

        Parameters
        ----------
        samples : ndarray, shape (n, 7)
            Seconds since the one before; the values are written.
        memory : FilterMemory
        said_s : float
            Since when that is said of them [s].
        """
        w, unit = memory.monitor.imu, memory.monitor.imu[kernel.UNIT]
        heard = [axis[kernel.CODE] not in (kernel.SILENT, kernel.CONTRADICTED) for axis in w[: kernel.UNIT]]
        if any(heard) or not memory.unfolded:  # a block, which ends at a fold, is no other than one after the other
            self.refer(w, memory.nav, memory.P)
        for name, axis, spoke in zip(self.axes, w[: kernel.UNIT], heard, strict=True):
            if spoke:
                yield Count("silent")
                axis[kernel.CODE] = axis[kernel.HEEDED] = kernel.SILENT
                yield AxisCondition(said_s, name, CONDITIONS[kernel.SILENT])
            axis[kernel.CLEAN_S] = 0.0
        samples[:, 1:4], samples[:, 4:] = 0.0, unit[kernel.REFERENCE : kernel.REFERENCE + 3]
        if self._increments:
            samples[:, 4:] *= samples[:, :1]

    def set_imu_noise(self, w: Array, C: Array, r: Array, output: Array) -> bool:
        """Error models of the axes as they are believed now: `output` (6, k + 1) from C (6, errors) and r (6,); whether
        any force is felt.

        A value that stands for nothing read has no bias, but all the noise of the unknown.
        """
        output[:, : C.shape[1]], output[:, -1] = C, r
        lost = w[: kernel.UNIT, kernel.HEEDED] > kernel.NOISY
        felt = not self.active or not lost[3:].all()
        for i, code in enumerate(w[: kernel.UNIT, kernel.HEEDED]):
            if code > kernel.NOISY:
                density = self._unseen[i] ** 2 * (settings.UNSEEN_S if felt or i < 3 else settings.TURN_S)
                if i > 2 and felt:
                    # the force at rest stands there, by the attitude as it is believed: its tilt is not felt
                    density += (w[kernel.UNIT, kernel.GRAVITY] * strapdown.GAP_TILT) ** 2 * settings.TURN_S
                elif i < 2:
                    # velocities show a tilt only where forces are felt
                    density = _tilts(w)[i] ** 2 / (strapdown.GAP_TILT_S if lost[3:].any() else settings.UNSEEN_S)
                output[i, :-1], output[i, -1] = 0.0, density / self._period_s
            elif code == kernel.NOISY:
                output[i, -1] = max(r[i], w[i, kernel.WHITE])
        return felt

    def rate_variance(self, w: Array, r: Array) -> Array:
        """Variance of the angular rate as it is used for lever arms, shape (3,) [rad^2/s^2]."""
        lost = w[:3, kernel.HEEDED] > kernel.NOISY
        return np.where(lost, self._unseen[:3] ** 2, r[:3]) if lost.any() else r[:3]

    def news(self, w: Array) -> bool:
        """Whether something is to be heeded."""
        return self.active and w.item(kernel.UNIT, kernel.NEWS) != 0.0

    def heed(self, filter: FilterState) -> Iterator[Action]:
        """Look at what the kernel has found, at the sample where it found it.

        Parameters
        ----------
        filter : FilterState
        """
        memory = filter.memory
        w, unit = memory.monitor.imu, memory.monitor.imu[kernel.UNIT]
        opened: list[Array] = []
        calm = not w[: kernel.UNIT, (kernel.CODE, kernel.HEEDED)].any()
        for i in range(6):
            axis = w[i]
            code, heeded = axis[kernel.CODE], axis[kernel.HEEDED]
            if axis[kernel.SIZE]:
                yield Count("spike")
                opened.append(self._done(i, axis[kernel.SIZE], self._period_s, memory.nav))
                axis[kernel.SIZE] = 0.0
            if code != heeded:
                if code != kernel.GOOD:
                    yield Count(CONDITIONS[int(code)])
                if code > kernel.NOISY >= heeded:
                    expected = 0.0 if i < 3 else unit[kernel.REFERENCE + i - 3]
                    most = max(self._unseen[i], abs(axis[kernel.MEAN] - expected))
                    opened.append(self._done(i, most, axis[kernel.BEGAN_S], memory.nav))
                axis[kernel.HEEDED] = code
                yield AxisCondition(memory.time_s, self.axes[i], CONDITIONS[int(code)])
            if code == kernel.NOISY:
                axis[kernel.WHITE] = axis[kernel.NOISE] / 6.0
        if opened:
            yield Fold()
            for done in opened:
                yield Inflate(slice(9), slice(9), np.outer(done, done))
        if unit[kernel.TICK] * self._period_s >= kernel.JUDGED_S:
            unit[kernel.TICK] = 0.0
            lost = w[: kernel.UNIT, kernel.HEEDED] > kernel.NOISY
            if lost[:2].any() and lost[3:].all():
                yield from _come_back_to_level(memory)
            self.refer(w, memory.nav, memory.P)
        if not calm:
            yield Reweigh()  # last: from the same memory it comes out the same, whenever it is recalled

    def refer(self, w: Array, nav: Array, P: Array) -> None:
        """Take the reference of gravity from the attitude as it is now."""
        if self.active:
            unit, g = w[kernel.UNIT], strapdown.gravity(nav[0], nav[2])
            unit[kernel.REFERENCE : kernel.REFERENCE + 3] = -g * nav[12:15]
            unit[kernel.GRAVITY], unit[kernel.SURE] = g, float(P[6, 6] + P[7, 7] < kernel.LEVEL_SD**2)
            if unit[kernel.SURE]:
                unit[TILTS] = np.maximum(unit[TILTS], np.abs(nav[13:11:-1]))

    def _done(self, axis: int, error: float, seconds: float, nav: Array) -> Array:
        """What an error [rad/s, m/s^2] of an axis that lasted so long does to the nine navigation states."""
        along, result = nav[6:15].reshape(3, 3)[:, axis % 3] * error * seconds, np.zeros(9)
        if axis < 3:
            g = strapdown.gravity(nav[0], nav[2])
            result[6:] = along
            result[3:5] = 0.5 * seconds * g * np.array([-along[1], along[0]])
            result[:3] = result[3:6] * seconds / 3.0
        else:
            result[3:6] = along
            result[:3] = 0.5 * seconds * along
        return result

    def excluded_axes(self, w: Array) -> list[str]:
        """Names of the axes that something else stands in for."""
        heeded = w[: kernel.UNIT, kernel.HEEDED].tolist()
        return [name for name, code in zip(self.axes, heeded, strict=False) if code > kernel.NOISY]

    def replaced_s(self, w: Array) -> float:
        """So long ago what is left out may have begun to be wrong, or was looked at last [s]."""
        lost = w[: kernel.UNIT, kernel.HEEDED] > kernel.NOISY
        return settings.FOUND_S + kernel.JUDGED_S + float(w[: kernel.UNIT, kernel.BEGAN_S][lost].max(initial=0.0))

    def conditions(self, w: Array) -> dict[str, str]:
        """Condition of every axis in words; none where nothing is watched."""
        if not (self.active and self._feels):
            return {}
        return {name: CONDITIONS[int(w[i, kernel.CODE])] for i, name in enumerate(self.axes)}


def _tilts(w: Array) -> Array:
    """How far a vehicle rolls, and pitches, standard deviations [rad]: as far as it has, a usual one at least."""
    return np.maximum(strapdown.GAP_TILT, w[kernel.UNIT, TILTS])


def _come_back_to_level(memory: FilterMemory) -> Iterator[Action]:
    """What a vehicle rolls and pitches by is bounded: once a second, level is a reading of the random walk, with a
    variance that leaves it as far as the vehicle goes.
    """
    yield Fold()
    P, C = memory.P, memory.nav[6:15].reshape(3, 3)
    H = np.zeros((2, len(P)))
    H[:, 6:9] = C.T[:2]
    S = H @ P @ H.T + np.diag(_tilts(memory.monitor.imu) ** 2) * strapdown.GAP_TILT_S / kernel.JUDGED_S
    K = np.linalg.solve(S, H @ P).T
    yield Correct(np.asarray(K @ (C.T[:2] @ turn_to_down(C[:, 2])), dtype=np.float64), -K @ S @ K.T)


@lru_cache(64)  # other sensors' error models change under way, those of the unit hardly ever
def _quick(model: ErrorModel, period_s: float) -> float:
    """Variance of the second differences of the quick coloured errors among the parts of a model."""
    total = 0.0
    for part in model.parts if isinstance(model, Sum) else (model,):
        b = part.block(period_s)
        if not b.size:
            continue
        # x(k) - 2 x(k-1) + x(k-2), by what stands at k-2 and what has come since
        last, new = b.C @ (b.Phi @ b.Phi - 2.0 * b.Phi + np.eye(b.size)), b.C @ (b.Phi - 2.0 * np.eye(b.size))
        square = float(last @ b.P0 @ last + new @ b.Q @ new + b.C @ b.Q @ b.C)
        if square > settings.QUICK * float(b.C @ b.P0 @ b.C):
            total += square
    return total
