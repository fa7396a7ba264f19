"""ARMA models as values: an immutable model, its spectrum, its simulation and its forecast.

Sign convention, everywhere in navfilter: ``A(q) y = C(q) e`` with ``A = 1 + a1 q^-1 + ...`` and
``C = 1 + c1 q^-1 + ...``, that is ``y = scipy.signal.lfilter([1, *ma], [1, *ar], e)`` (MATLAB ``armax``).

Exact algebra of ARMA models: decimation, sums, the reading as bias + white + lines, and the bias split off.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import scipy  # its parts are imported when they are first used: that takes a second
from numpy.polynomial import chebyshev
from numpy.polynomial.polynomial import polypow

from navfilter.foundation.arguments import needs, numbers
from navfilter.foundation.arrays import Array, ArrayLike, Complex
from navfilter.foundation.frozen import FrozenDescription
from navfilter.timeseries.roots import is_stable, roots_of, slowest_real
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


#: Largest misfit of a factor, relative to lag 0: beyond it there is none.
ACCEPTED = 1e-6
#: A factor that fits worse than this is looked for once more, its zeros on the unit circle taken out first.
RETRIED = 1e-9
#: Zeros are on the circle where taking them out leaves no more than this, relative to lag 0: rounding.
ON_CIRCLE = 1e-12


def resample_arma(model: ArmaModel, m: int) -> ArmaModel:
    """Exact model of every `m`-th sample of the series.

    The poles become ``pole**m``. Multiplying ``A y = C e`` by ``T = A_m(q^m)/A(q)``, a finite sum even for unit roots,
    leaves a moving average ``T C e`` that is seen at every m-th sample only; its order is ``floor(p + (q - p)/m)``, and
    spectral factorisation gives its coefficients. Nothing is approximated and no stability is required.

    Parameters
    ----------
    model : ArmaModel
        Model of the fast series.
    m : int
        Decimation, at least 1.

    Examples
    --------
    >>> slow = resample_arma(ArmaModel([-0.9], [], 1.0), 2)
    >>> slow.ar.round(6), slow.q, round(slow.sd**2, 6)
    (array([-0.81]), 0, 1.81)
    """
    if m < 1 or m != int(m):
        raise ValueError(f"m must be a whole number of samples, at least 1, found {m}.")
    if m == 1:
        return model
    poles = model.poles
    wide = np.array([1.0 + 0.0j])
    for pole in poles:
        wide = np.convolve(wide, pole ** np.arange(m))
    d = np.convolve(wide.real, np.r_[1.0, model.ma])
    ar = np.real(np.poly(poles**m))[1:] if poles.size else np.zeros(0)
    q = (d.size - 1) // m
    gamma = np.array([d[: d.size - k * m] @ d[k * m :] for k in range(q + 1)])
    ma, sd = spectral_factor(gamma)
    window = None if model.effective_window is None else model.effective_window / m
    return ArmaModel(ar, ma, sd * model.sd, effective_window=window, flags=model.flags | {"resampled"})


def add_arma(models: Iterable[ArmaModel]) -> ArmaModel:
    """Model of the sum of independent ARMA series (Granger and Morris 1976): product of the AR parts, exact MA part.

    Examples
    --------
    >>> walk, white = ArmaModel([-1.0], [], 0.1), ArmaModel([], [], 1.0)
    >>> add_arma([walk, white]).ma.round(4)
    array([-0.9049])
    """
    needs("add_arma: models", models, Sequence, hint="As add_arma([a, b]).")
    for part in models:
        needs("add_arma: each of them", part, ArmaModel)
    parts = [part for part in models if part.sd > 0.0]
    if not parts:
        return ArmaModel(np.zeros(0), np.zeros(0), 0.0)
    polynomials = [np.r_[1.0, part.ar] for part in parts]
    ar = np.array([1.0])
    for polynomial in polynomials:
        ar = np.convolve(ar, polynomial)
    drives = []
    for i, part in enumerate(parts):
        drive = part.sd * np.r_[1.0, part.ma]
        for j, polynomial in enumerate(polynomials):
            if j != i:
                drive = np.convolve(drive, polynomial)
        drives.append(drive)
    order = max(drive.size for drive in drives)
    gamma = [sum(float(d[: max(d.size - k, 0)] @ d[k:]) for d in drives) for k in range(order)]
    ma, sd = spectral_factor(gamma)
    return ArmaModel(ar[1:], ma, sd)


# A pole this small is gone after a sample or two: its part counts as white noise.
_BRIEF = 0.3


@dataclass(frozen=True)
class Line:
    """A narrow resonance: `freq` in cycles per sample, `radius` of its poles, `sd` of its contribution."""

    freq: float
    radius: float
    sd: float


@dataclass(frozen=True)
class BiasPlusWhite:
    """A slow bias ``x+ = pole x + w`` plus white noise, plus any lines.

    Attributes
    ----------
    white_sd : float
        Standard deviation of the white part.
    drive_sd : float
        Standard deviation of w, per sample. With ``pole = 1`` this is a random walk, below 1 first-order Gauss-Markov.
    pole : float
        Pole of the bias; 0 when the model has no real positive pole.
    lines : tuple of Line
        What other poles add, strongest first: resonances, and at frequency 0 further slow parts. Described, not
        included in `model`.
    """

    white_sd: float
    drive_sd: float
    pole: float
    lines: tuple[Line, ...] = ()

    @property
    def model(self) -> ArmaModel:
        """The bias and the white noise as one ARMA(1,1) model (IMA(1,1) when the pole is 1)."""
        bias = ArmaModel(np.array([-self.pole]) if self.pole else np.zeros(0), np.zeros(0), self.drive_sd)
        return add_arma([bias, ArmaModel(np.zeros(0), np.zeros(0), self.white_sd)])


def bias_plus_white(model: ArmaModel) -> BiasPlusWhite:
    """Read a model as random-walk or Gauss-Markov bias + white noise + lines.

    Exact for orders (0,0), (1,0) and (1,1); its inverse is `BiasPlusWhite.model`. For larger models the spectrum is
    split into partial fractions: the slowest real pole is the bias, the others are lines (below radius 0.3: white).

    Raises
    ------
    ValueError
        When the model cannot be such a sum: no split leaves all variances positive.

    Examples
    --------
    >>> reading = bias_plus_white(ArmaModel([-1.0], [-0.982], 1.0))
    >>> round(reading.drive_sd, 4), round(reading.white_sd, 4), reading.pole
    (0.018, 0.991, 1.0)
    """
    needs("bias_plus_white: model", model, ArmaModel, hint="That of a fit is fit.model.")
    poles = model.poles
    if not poles.size:
        if model.q:
            raise ValueError(f"a pure moving average of order {model.q} holds no bias.")
        return BiasPlusWhite(model.sd, 0.0, 0.0)
    drives = np.array([_drive_power(model, i) for i in range(poles.size)])
    real = (np.abs(poles.imag) < 1e-9) & (poles.real > 0.0)
    slow = [int(i) for i in np.flatnonzero(real) if drives[i].real > 0.0]
    bias = max(slow, key=lambda i: poles[i].real, default=None)
    pole = float(poles[bias].real) if bias is not None else 0.0
    drive = float(drives[bias].real) if bias is not None else 0.0
    lines, spread = [], 0.0
    for i in range(poles.size):
        pole_i, radius = poles[i], float(abs(poles[i]))
        if i == bias or pole_i.imag < 0.0:
            continue
        pair = 2.0 if pole_i.imag > 0.0 else 1.0
        variance = pair * (drives[i] / (1.0 - pole_i**2)).real if radius < 1.0 else np.inf
        if radius < _BRIEF:
            spread += variance
        elif variance > 0.0:
            lines.append(Line(float(np.angle(pole_i) / (2.0 * np.pi)), radius, float(np.sqrt(variance))))
    white = _white_power(model, poles, drives) + spread
    if white < -1e-9 * model.sd**2:
        raise ValueError(f"no split into bias + white noise: the white variance would be {white:.3g}.")
    lines.sort(key=lambda line: -line.sd)
    return BiasPlusWhite(float(np.sqrt(max(white, 0.0))), float(np.sqrt(drive)), pole, tuple(lines))


def _drive_power(model: ArmaModel, i: int) -> complex:
    """Residue of the spectrum at pole i: the power w of the term ``w / ((1 - p B)(1 - p/B))`` for a real pole."""
    others = np.delete(model.poles, i)
    p = model.poles[i]
    ma = np.r_[1.0, model.ma][::-1]
    numerator = np.polyval(ma, p) * np.polyval(ma, 1.0 / p)
    return complex(model.sd**2 * numerator / np.prod(1.0 - others * p) / np.prod(1.0 - others / p))


def _white_power(model: ArmaModel, poles: Complex, drives: Complex) -> float:
    """What the poles leave over, averaged over frequency (exactly constant when q <= p)."""
    w = 2.0 * np.pi * (np.arange(512) + 0.5) / 512
    z = np.exp(-1j * w)
    response = np.polyval(np.r_[1.0, model.ma][::-1], z) / np.polyval(np.r_[1.0, model.ar][::-1], z)
    total = model.sd**2 * np.abs(response) ** 2
    parts = sum(d / ((1.0 - p * z) * (1.0 - p / z)) for p, d in zip(poles, drives, strict=True))
    return float(np.mean(np.real(total - parts)))


def split_bias(model: ArmaModel) -> tuple[float, ArmaModel]:
    """Split a model with a pole at (or near) 1 into a random-walk bias and the independent rest.

    The slowest real pole is taken as 1. Then ``sd^2 |C|^2 / |A|^2 = walk_sd^2 / |1 - z|^2 + |N|^2 / |A'|^2`` with
    ``walk_sd = sd C(1) / A'(1)``; the rest's moving average N is the spectral factor of what remains. For ARMA(1, 1)
    it is random walk + white noise (Muth 1960).

    Parameters
    ----------
    model : ArmaModel
        With at least one real positive pole.

    Returns
    -------
    walk_sd : float
        Standard deviation of the walk's step per sample.
    rest : ArmaModel
        Independent of the walk, with its covariance carried over to first order; ``sd`` 0 if nothing remains.

    Raises
    ------
    ValueError
        If no such sum has the model's spectrum (the rest would need a negative power somewhere).

    Examples
    --------
    >>> walk_sd, rest = split_bias(ArmaModel([-1.0], [-0.9], 1.0))
    >>> round(walk_sd, 6), rest.p, rest.q, round(rest.sd, 6)
    (0.1, 0, 0, 0.948683)
    """
    walk_sd, ar, ma, sd = _split(model.ar, model.ma, model.sd)
    if model.covariance is None:
        return walk_sd, ArmaModel(ar, ma, sd, None, None, model.effective_window, model.flags)
    theta, p = np.r_[model.ar, model.ma], model.p
    jacobian = np.zeros((ar.size + ma.size, theta.size))
    for i in range(theta.size):
        # Towards a larger white part for the pole, away from the boundary of what can be split.
        step = 1e-6 * max(1.0, abs(theta[i]))
        try:
            other = theta + step * (np.arange(theta.size) == i)
            moved = _split(other[:p], other[p:], model.sd)
        except ValueError:
            continue
        jacobian[:, i] = (np.r_[moved[1], moved[2]] - np.r_[ar, ma]) / step
    covariance = jacobian @ model.covariance @ jacobian.T
    window = model.effective_window or 1.0
    spread = log_s0_sd(ar, ma, covariance, window)
    return walk_sd, ArmaModel(ar, ma, sd, covariance, spread, model.effective_window, model.flags)


def _split(ar: Array, ma: Array, sd: float) -> tuple[float, Array, Array, float]:
    poles = np.roots(np.r_[1.0, ar])
    slowest = slowest_real(poles, above=0.0)
    if slowest is None:
        raise ValueError(f"no real positive pole to split off, found {poles}.")
    others = np.delete(poles, slowest)
    rest = np.atleast_1d(np.poly(others)).real
    lead = np.r_[1.0, ma]
    walk = float(lead.sum() / rest.sum())
    reach = max(lead.size, rest.size) - 1
    power = np.zeros(2 * reach + 1)
    for poly, weight in ((lead, 1.0), (rest, -(walk**2))):
        both = weight * np.convolve(poly, poly[::-1])
        power[reach - poly.size + 1 : reach + poly.size] += both
    if reach == 0:
        return abs(walk) * sd, rest[1:], np.zeros(0), 0.0
    quotient = np.polydiv(power, np.array([-1.0, 2.0, -1.0]))[0]
    numerator, scale = spectral_factor(quotient[reach - 1 :])
    return abs(walk) * sd, rest[1:], numerator, scale * sd


# --- spectral factorisation ------------------------------------------------------------------------------------------


def spectral_factor(autocovariance: ArrayLike) -> tuple[Array, float]:
    """Invertible moving average with a given autocovariance.

    Newton's method of G. Wilson (SIAM J. Numer. Anal. 6, 1969): quadratic, and from its start every iterate keeps
    all zeros inside the circle. A multiple zero on the circle makes its equations singular; such zeros are found by
    themselves and divided out, and the method is applied to what is left.

    Parameters
    ----------
    autocovariance : array_like, shape (q+1,)
        Lags 0 ... q; all further lags are zero.

    Returns
    -------
    ma : ndarray, shape (q,)
        Coefficients with zeros inside or on the unit circle.
    sd : float
        Standard deviation of the innovation.

    Raises
    ------
    ValueError
        When no moving average of order q has this autocovariance.

    Examples
    --------
    >>> ma, sd = spectral_factor([20.0, -15.0, 6.0, -1.0])
    >>> ma.round(6), round(sd, 6)
    (array([-3.,  3., -1.]), 1.0)
    """
    gamma = np.array(autocovariance, dtype=np.float64)
    n = gamma.size
    if n == 0 or not np.all(np.isfinite(gamma)) or gamma[0] <= 0.0:
        raise ValueError("the autocovariance must be finite and positive at lag 0.")
    scale = gamma[0]
    gamma = gamma / scale
    c = _newton(gamma)
    if not _misfit(c, gamma) < RETRIED:
        circle, rest = _without_circle_zeros(gamma)
        if circle.size > 1 and rest[0] > 0.0:
            c = min(c, np.convolve(circle, _newton(rest)), key=lambda found: _misfit(found, gamma))
    worst = _misfit(c, gamma)
    if not worst < ACCEPTED:
        raise ValueError(f"not an autocovariance: no moving average of order {n - 1} has it (misfit {worst:.1e}).")
    return c[1:] / c[0], float(c[0] * np.sqrt(scale))


def _products(c: Array) -> Array:
    """Autocovariance of ``c0 + c1 q^-1 + ...``, shape (n,)."""
    return np.array([c[: c.size - k] @ c[k:] for k in range(c.size)])


def _misfit(c: Array, gamma: Array) -> float:
    worst = float(np.abs(_products(c) - gamma).max())
    return worst if np.isfinite(worst) else np.inf


def _newton(gamma: Array) -> Array:
    """Wilson's iteration: ``c0 + c1 q^-1 + ...`` with this autocovariance, as far as it converges."""
    n = gamma.size
    c = np.zeros(n)
    c[0] = 1.0
    for _ in range(200):
        lead = np.array([[c[j - i] if j >= i else 0.0 for j in range(n)] for i in range(n)])
        lag = np.array([[c[i + j] if i + j < n else 0.0 for j in range(n)] for i in range(n)])
        try:
            new = np.linalg.solve(lead + lag, gamma + _products(c))
        except np.linalg.LinAlgError:
            break
        change, c = np.abs(new - c).max(), new
        if change < 1e-15:
            break
    return c


# ---------------------------------------------------------------- zeros on the circle


def _without_circle_zeros(gamma: Array) -> tuple[Array, Array]:
    """Polynomial of the zeros on the unit circle, and the autocovariance that they leave over.

    As a polynomial of x = cos w the spectrum touches zero there: a zero at 1 or -1 is a root at an end of [-1, 1], and
    a pair of multiplicity m a root of multiplicity 2m between, where the derivative of order 2m - 1 has a simple one.
    """
    circle, rest = np.ones(1), gamma
    for degree in range(gamma.size - 1, 0, -1):
        while (taken := _multiple_zero(rest, degree)) is not None:
            circle, rest = np.convolve(circle, taken[0]), taken[1]
    return circle, rest


def _multiple_zero(gamma: Array, degree: int) -> tuple[Array, Array] | None:
    """One multiple zero on the circle, as a polynomial of this degree, and what is left without it; None if there is
    none.
    """
    if degree >= gamma.size:
        return None
    zeros: list[tuple[list[float], int]] = [([1.0, -1.0], degree), ([1.0, 1.0], degree)]
    if degree % 2 == 0:
        roots = chebyshev.chebroots(chebyshev.chebder(np.r_[gamma[0], 2.0 * gamma[1:]], degree - 1))
        between = roots[(roots.imag == 0.0) & (np.abs(roots) < 1.0)].real
        zeros += [([1.0, -2.0 * x, 1.0], degree // 2) for x in between]
    for zero, times in zeros:
        factor = np.asarray(polypow(zero, times), dtype=np.float64)
        quotient, left = _divided(gamma, factor)
        if left < ON_CIRCLE * gamma[0]:
            return factor, quotient
    return None


def _divided(gamma: Array, factor: Array) -> tuple[Array, float]:
    """Autocovariance of what gives `gamma` when filtered by `factor`, by least squares, and the largest misfit."""
    both = np.convolve(factor, factor[::-1])
    n, order = gamma.size, factor.size - 1
    table = np.zeros((2 * n - 1, n - order))
    for k in range(n - order):
        for lag in {k, -k}:
            first = n - 1 + lag - order
            table[first : first + both.size, k] += both
    wanted = np.r_[gamma[:0:-1], gamma]
    quotient = np.asarray(np.linalg.lstsq(table, wanted, rcond=None)[0], dtype=np.float64)
    return quotient, float(np.abs(table @ quotient - wanted).max())
