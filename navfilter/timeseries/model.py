"""ARMA models as values: an immutable model, its spectrum, its simulation and its forecast.

Sign convention, everywhere in navfilter: ``A(q) y = C(q) e`` with ``A = 1 + a1 q^-1 + ...`` and
``C = 1 + c1 q^-1 + ...``, that is ``y = scipy.signal.lfilter([1, *ma], [1, *ar], e)`` (MATLAB ``armax``).
"""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import scipy  # its parts are imported when they are first used: that takes a second

from navfilter.foundation.arguments import numbers
from navfilter.foundation.arrays import Array, ArrayLike, Complex
from navfilter.foundation.frozen import FrozenDescription
from navfilter.timeseries.roots import is_stable, roots_of
from navfilter.timeseries.stationary import observer, settled


def _coefficients(values: ArrayLike | None, name: str) -> Array:
    """Copy of `values` as a read-only 1-D float64 array, refused when not finite."""
    array = np.array([] if values is None else numbers(values, name), ndmin=1)
    if array.ndim != 1:
        raise ValueError(
            f"{name} must be one-dimensional, found shape {array.shape}. Pass [c1, c2, ...] without the 1."
        )
    if not np.all(np.isfinite(array)):
        raise ValueError(f"{name} must be finite, found {array.tolist()}.")
    array.setflags(write=False)
    return array


def log_s0_sd(ar: ArrayLike, ma: ArrayLike, covariance: ArrayLike, window: float) -> float:
    """Standard deviation of ``ln S(0)``, S(0) being the spectral density at zero frequency.

    ``S(0) = sd^2 (C(1)/A(1))^2``, so to first order ``var ln S(0) = g' P g + 2/W`` with
    ``g = 2 [-1/A(1) ..., 1/C(1) ...]``: the uncertainty that decides how much a navigation filter should inflate
    the model's driving noise.

    Parameters
    ----------
    ar, ma : array_like, shapes (p,) and (q,)
        Coefficients.
    covariance : array_like, shape (p+q, p+q)
        Covariance of ``[ar, ma]``.
    window : float
        Effective number of samples behind the estimate.

    Returns
    -------
    float
        Infinite at a unit root (pole or zero exactly at 1).
    """
    a, c = np.asarray(ar, dtype=np.float64).ravel(), np.asarray(ma, dtype=np.float64).ravel()
    a1, c1 = 1.0 + float(np.sum(a)), 1.0 + float(np.sum(c))
    if a1 == 0.0 or c1 == 0.0:
        return float("inf")
    g = 2.0 * np.concatenate([np.full(a.size, -1.0 / a1), np.full(c.size, 1.0 / c1)])
    quadratic = float(g @ np.asarray(covariance, dtype=np.float64) @ g)
    return float(np.sqrt(max(quadratic, 0.0) + 2.0 / window))


@dataclass(frozen=True, eq=False)
class ArmaModel(FrozenDescription):
    """An ARMA model of a sampled series: a value that never changes.

    Parameters
    ----------
    ar, ma : array_like, shapes (p,) and (q,)
        Coefficients in the sign of ``lfilter([1, *ma], [1, *ar], e)``; kept as read-only float64 arrays.
    sd : float
        Standard deviation of the innovation e, in the unit of the series.
    covariance : array_like, shape (p+q, p+q), optional
        Covariance of ``[ar, ma]``.
    sd_log_s0 : float, optional
        Standard deviation of ln S(0), see `log_s0_sd`.
    effective_window : float, optional
        Number of samples behind the estimate.
    flags : frozenset of str
        Remarks of the estimator ("unit root", "quantised", "fallback", ...).

    Raises
    ------
    ValueError
        For coefficients that are not finite, a negative `sd`, or a covariance of the wrong shape.

    Examples
    --------
    >>> model = ArmaModel([-0.8], [-0.6], 1.0)
    >>> model.p, model.q, model.is_stable, round(model.variance, 4)
    (1, 1, True, 1.1111)
    """

    ar: Array
    ma: Array
    sd: float
    covariance: Array | None = None
    sd_log_s0: float | None = None
    effective_window: float | None = None
    flags: frozenset[str] = frozenset()

    if TYPE_CHECKING:  # what is handed over becomes what the fields are

        def __init__(
            self,
            ar: ArrayLike,
            ma: ArrayLike,
            sd: float,
            covariance: ArrayLike | None = None,
            sd_log_s0: float | None = None,
            effective_window: float | None = None,
            flags: str | Iterable[str] = frozenset(),
        ) -> None: ...

    def __post_init__(self) -> None:
        put = object.__setattr__
        put(self, "ar", _coefficients(self.ar, "ar"))
        put(self, "ma", _coefficients(self.ma, "ma"))
        put(self, "sd", float(numbers(self.sd, "sd")))
        put(self, "flags", frozenset([self.flags] if isinstance(self.flags, str) else self.flags))
        if not (np.isfinite(self.sd) and self.sd >= 0.0):
            raise ValueError(f"sd must be finite and not negative, found {self.sd}.")
        if self.covariance is not None:
            covariance = np.array(self.covariance, dtype=np.float64)
            n = self.p + self.q
            if covariance.shape != (n, n):
                raise ValueError(
                    f"covariance must be {n} x {n} for orders ({self.p}, {self.q}), found {covariance.shape}."
                )
            covariance.setflags(write=False)
            put(self, "covariance", covariance)

    def _key(self) -> tuple[object, ...]:
        covariance = None if self.covariance is None else self.covariance.tobytes()
        # Adding 0.0 turns -0.0 into 0.0, so that equal numbers compare equal as bytes.
        ar, ma = (self.ar + 0.0).tobytes(), (self.ma + 0.0).tobytes()
        return (ar, ma, self.sd, covariance, self.sd_log_s0, self.effective_window, self.flags)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, ArmaModel) and self._key() == other._key()

    def __hash__(self) -> int:
        return hash(self._key())

    @property
    def p(self) -> int:
        """Number of autoregressive coefficients."""
        return int(self.ar.size)

    @property
    def q(self) -> int:
        """Number of moving-average coefficients."""
        return int(self.ma.size)

    @property
    def is_stable(self) -> bool:
        """All poles strictly inside the unit circle."""
        return is_stable(self.ar)

    @property
    def is_invertible(self) -> bool:
        """All zeros strictly inside the unit circle."""
        return is_stable(self.ma)

    @property
    def poles(self) -> Complex:
        """Roots of ``z^p A(z)``, largest first."""
        return roots_of(self.ar)

    @property
    def zeros(self) -> Complex:
        """Roots of ``z^q C(z)``, largest first."""
        return roots_of(self.ma)

    @property
    def variance(self) -> float:
        """Variance of the series; infinite when the model is not stable."""
        return float(self.autocovariance(0)[0]) if self.is_stable else float("inf")

    def psi(self, n: int) -> Array:
        """First `n` impulse-response coefficients, ``psi[0] = 1``."""
        impulse = np.zeros(n)
        impulse[:1] = 1.0
        return np.asarray(scipy.signal.lfilter(np.r_[1.0, self.ma], np.r_[1.0, self.ar], impulse))

    def spectrum(self, freq_hz: ArrayLike, rate_hz: float) -> Array:
        """One-sided power spectral density, unit^2/Hz: its integral over 0 ... rate/2 is the variance.

        Parameters
        ----------
        freq_hz : array_like
            Frequencies, Hz.
        rate_hz : float
            Sampling rate of the series, Hz.
        """
        w = 2.0 * np.pi * np.asarray(freq_hz, dtype=np.float64) / rate_hz
        z, polyval = np.exp(-1j * w), np.polynomial.polynomial.polyval
        with np.errstate(divide="ignore", invalid="ignore"):
            response = polyval(z, np.r_[1.0, self.ma]) / polyval(z, np.r_[1.0, self.ar])
        return np.asarray(2.0 * self.sd**2 / rate_hz * np.abs(response) ** 2)

    def autocovariance(self, lags: int) -> Array:
        """Autocovariance at lags 0 ... `lags`, shape (lags+1,).

        Raises
        ------
        ValueError
            When the model is not stable: its autocovariance does not exist.
        """
        if not self.is_stable:
            raise ValueError(
                f"the autocovariance of an unstable model does not exist (largest pole {np.abs(self.poles).max():.6f})."
            )
        step, drive, P = self.observer_form()
        variance = self.sd**2
        if not P.size:
            return np.r_[variance, np.zeros(lags)]
        # gamma_k = h' M^(k-1) cov(state after t, y_t): the filter's free response from that vector.
        start = step @ P[:, 0] + variance * drive
        c, a = np.zeros(P.shape[0] + 1), np.zeros(P.shape[0] + 1)
        c[0] = a[0] = 1.0
        c[1 : self.q + 1], a[1 : self.p + 1] = self.ma, self.ar
        tail, _ = scipy.signal.lfilter(c, a, np.zeros(lags), zi=start) if lags else (np.zeros(0), None)
        return np.r_[variance + P[0, 0], tail]

    def observer_form(self) -> tuple[Array, Array, Array]:
        """Observer form ``z+ = M z + g e``, ``y = z[0] + e`` (the state of `lfilter`) and its stationary covariance."""
        r = max(self.p, self.q)
        a, c = np.zeros(r), np.zeros(r)
        a[: self.p], c[: self.q] = self.ar, self.ma
        step, drive = observer(a, c)
        return step, drive, settled(step, self.sd**2 * np.outer(drive, drive))


def simulate_arma(
    ar: ArrayLike, ma: ArrayLike, sd: float, n: int, seed: int | np.random.Generator | None = None
) -> Array:
    """Simulate `n` samples of a Gaussian ARMA process.

    A stable model starts in its stationary distribution, exactly (no burn-in). A model with poles on or outside the
    unit circle has none, and starts from zero.

    Parameters
    ----------
    ar, ma : array_like
        Coefficients, sign of ``lfilter([1, *ma], [1, *ar], e)``.
    sd : float
        Standard deviation of the innovation.
    n : int
        Number of samples.
    seed : int, Generator or None
        Source of randomness: the same seed gives the same series.

    Examples
    --------
    >>> x = simulate_arma([-0.9], [], 1.0, 5, seed=1)
    >>> x.shape, bool(abs(x[1] - 0.9 * x[0]) < 5)
    ((5,), True)
    """
    if not isinstance(n, int | float | np.integer) or n < 0 or n != int(n):
        raise ValueError(f"n must be a whole number of samples, not negative, found {n!r}.")
    n, model = int(n), ArmaModel(np.asarray(ar), np.asarray(ma), sd)
    random = np.random.default_rng(seed)
    r = max(model.p, model.q)
    start = np.zeros(r)
    if r and model.is_stable:
        _, _, P = model.observer_form()
        values, vectors = np.linalg.eigh(P)
        start = vectors @ (np.sqrt(np.maximum(values, 0.0)) * random.standard_normal(r))
    e = model.sd * random.standard_normal(n)
    if r == 0:
        return e
    y, _ = scipy.signal.lfilter(np.r_[1.0, model.ma], np.r_[1.0, model.ar], e, zi=start)
    return np.asarray(y)


def forecast_arma(model: ArmaModel, series: ArrayLike, steps: int) -> tuple[Array, Array]:
    """Forecast the next `steps` samples and their standard deviations.

    Parameters
    ----------
    model : ArmaModel
        Invertible model.
    series : array_like, shape (n,)
        Past samples without gaps, oldest first; filter memory before the first is taken as zero.
    steps : int
        Number of samples to forecast.

    Returns
    -------
    mean, sd : ndarray, shape (steps,)
        Expected values, and the standard deviation of their errors ``sd * sqrt(sum psi^2)``.
    """
    x = numbers(series, "series").ravel()
    if not model.is_invertible:
        raise ValueError("forecasting needs an invertible model: reflect the zeros into the unit circle first.")
    if not np.all(np.isfinite(x)):
        raise ValueError("the past contains samples that are not finite: forecast from the last gap-free stretch.")
    spread = model.sd * np.sqrt(np.cumsum(model.psi(steps) ** 2))
    r = max(model.p, model.q)
    if r == 0:
        return np.zeros(steps), spread
    e = scipy.signal.lfilter(np.r_[1.0, model.ar], np.r_[1.0, model.ma], x)
    c, a = np.r_[1.0, model.ma], np.r_[1.0, model.ar]
    _, state = scipy.signal.lfilter(c, a, e, zi=np.zeros(r))
    mean, _ = scipy.signal.lfilter(c, a, np.zeros(steps), zi=state)
    return np.asarray(mean), spread
