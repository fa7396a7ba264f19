"""What a navigation error does to the open-loop residual of a sensor: a chain of integrators whose noise is known."""

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from navfilter.foundation.arrays import Array

#: Time in which a filter finds a wrong force [s]: before a drift begins anew, so much of a series is worth nothing.
FOUND_S = 10.0


@dataclass(frozen=True)
class Drift:
    """A chain of integrators driven by white noise: ``d1' = d2 + w1, d2' = d3 + w2, ...``, diffuse at the start.

    Parameters
    ----------
    density : tuple of float
        Root power spectral densities of w1, w2, ... (unit per s^(i-1) and sqrt(Hz)), 0 to 4 of them; empty: no drift.
    period_s : float
        Sampling period, s.
    start_sd : tuple of float, optional
        What is known of the states at the start of a series (unit per s^(i-1)), infinite for nothing, which is the
        default. A finite one, such as the filter's own for the gyro bias, tells more of the low frequencies of a short
        series; those after the first finite one must be finite too.
    most_turned : float
        Where more force than this was found wrong while the vehicle pitched or rolled [m/s^2], the chain begins anew.

    Raises
    ------
    ValueError
        For more than four integrators, densities that are negative or not finite, a period that is not positive, a
        start that does not fit.

    Examples
    --------
    >>> drift = Drift((1e-4, 1e-6), 0.125)          # heading: angular random walk, then the walk of the gyro bias
    >>> drift.transition()
    array([[1.   , 0.125],
           [0.   , 1.   ]])
    """

    density: tuple[float, ...]
    period_s: float
    start_sd: tuple[float, ...] = ()
    most_turned: float = math.inf

    def __post_init__(self) -> None:
        density = tuple(float(value) for value in self.density)
        object.__setattr__(self, "density", density)
        object.__setattr__(self, "period_s", float(self.period_s))
        if len(density) > 4:
            raise ValueError(f"a drift has at most 4 integrators, found {len(density)} densities.")
        if not all(math.isfinite(value) and value >= 0.0 for value in density):
            raise ValueError(f"densities must be finite and not negative, found {density}.")
        if not (math.isfinite(self.period_s) and self.period_s > 0.0):
            raise ValueError(f"period_s must be positive, found {self.period_s}.")

        start = tuple(float(value) for value in self.start_sd) or (math.inf,) * len(density)
        object.__setattr__(self, "start_sd", start)
        free = sum(math.isinf(value) for value in start)
        if (
            len(start) != len(density)
            or not all(value >= 0.0 for value in start)
            or not all(math.isinf(v) for v in start[:free])
        ):
            raise ValueError(
                f"start_sd must be {len(density)} numbers not below 0, the infinite ones first, found {start}."
            )

    @property
    def order(self) -> int:
        """Number of integrators r."""
        return len(self.density)

    def transition(self) -> Array:
        """Transition over one period, shape (r, r): ``period^(j-i) / (j-i)!`` above the diagonal."""
        return _chain_transition(self.order, self.period_s)

    def noise(self) -> Array:
        """Covariance of the noise added over one period, shape (r, r).

        ``sum over k >= i, j of density[k]^2 T^(2k-i-j+1) / ((k-i)! (k-j)! (2k-i-j+1))`` (Van Loan 1978, in closed
        form).
        """
        return _chain_noise(self.density, self.period_s)

    def begins_anew(self, turned: Array) -> list[int]:
        """Ticks at which the chain begins anew.

        Parameters
        ----------
        turned : ndarray, shape (n,)
            Sum of the force that was found while the vehicle pitched or rolled, see
            `navfilter.kernels.open_loop_residual`; NaN where there was no reading.
        """
        found: list[int] = []
        known = np.flatnonzero(np.isfinite(turned)) if math.isfinite(self.most_turned) else np.zeros(0, np.int64)
        while known.size:
            moved = np.abs(turned[known] - turned[known[0]]) > self.most_turned
            known = known[int(np.argmax(moved)) :] if moved.any() else known[:0]
            found.extend(known[:1].tolist())
        return found

    def per_tick(self) -> Array:
        """Noise with states in units per tick (state i times period^i) and, as last row, the variances of the start.

        Shape (r+1, r). In these units the transition has period 1.
        """
        scale = self.period_s ** np.arange(self.order)
        return np.vstack([self.noise() * np.outer(scale, scale), np.square(scale * self.start_sd)])


class DriftSource(Protocol):
    """A mechanisation, as a sensor sees it: the known noise of a navigation error in an open-loop residual.

    `walk` is the random walk of the sensor itself, as a root power spectral density of its rate; `period_s` is the
    sampling period.
    """

    def heading_drift(self, walk: float, period_s: float) -> Drift:
        """Of the heading error; walk in rad/s/sqrt(Hz)."""

    def velocity_drift(self, walk: float, period_s: float, *, vertical: bool = False) -> Drift:
        """Of one component of the velocity error; walk in m/s^2/sqrt(Hz)."""

    def position_drift(self, walk: float, period_s: float, *, vertical: bool = False) -> Drift:
        """Of one component of the position error; walk in m/s/sqrt(Hz)."""


def _chain_transition(r: int, period_s: float) -> Array:
    out = np.eye(r)
    for i in range(r):
        for j in range(i + 1, r):
            out[i, j] = period_s ** (j - i) / math.factorial(j - i)
    return out


def _chain_noise(density: tuple[float, ...], period_s: float) -> Array:
    r = len(density)
    out = np.zeros((r, r))
    for i in range(r):
        for j in range(r):
            for k in range(max(i, j), r):
                power = 2 * k - i - j + 1
                weight = math.factorial(k - i) * math.factorial(k - j) * power
                out[i, j] += density[k] ** 2 * period_s**power / weight
    return out
