"""The noise of an inertial axis at rest as a sum of terms, fitted to its spectrum by likelihood.

Each band of coefficients (see `navfilter.identification.noise_terms`) is a chi-square about its expectation, and
the curvature of the likelihood is the uncertainty.
"""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import fft, optimize, special, stats

from navfilter.foundation.arrays import Array

#: How far a logarithm may go from where the search begins.
FAR = 40.0
#: A Gauss-Markov term lives longer than so many samples and shorter than this share of the record, or it is another
#: term.
FEW, SHARE = 3.0, 0.5
#: A fit whose bands scatter more than chance does once in a hundred records is not complete.
SURPRISE = 0.01
#: Bands per decade of frequency.
PER_DECADE = 12


@dataclass(frozen=True)
class Term:
    """One fitted term.

    Attributes
    ----------
    kind : {"white", "flicker", "walk", "gauss-markov"}
    size, sd : float
        White: root density N [unit/sqrt(Hz)]; flicker: B of IEEE 952 [unit], with an Allan deviation of 0.664 B; walk:
        root density K of the rate of change [unit/s/sqrt(Hz)]; Gauss-Markov: standard deviation [unit]. And how
        uncertain it is.
    tau_s : float
        Correlation time of a Gauss-Markov term, NaN of others.
    """

    kind: str
    size: float
    sd: float
    tau_s: float = math.nan


@dataclass(frozen=True)
class NoiseFit:
    """Terms fitted to bands.

    Attributes
    ----------
    terms : tuple of Term
        The white one first.
    ratio : float
        Density at the Nyquist frequency over that of the white term, as if the trend went on up to there: 1 for white
        noise, more where angles are rounded (quantisation), less where the unit filters its output.
    rise, rise_sd : float
        Their difference [unit^2/Hz], and how uncertain it is.
    highest_hz : float
        Highest frequency that was fitted.
    cost : float
        Minus the logarithm of the likelihood of the bands, but for a constant.
    parameters, bands : int
    dispersion : float
        Scatter of the bands about the fit, in units of what chance gives; 1 where the terms explain them. The
        uncertainties have been multiplied by its root.
    """

    terms: tuple[Term, ...]
    ratio: float
    rise: float
    rise_sd: float
    highest_hz: float
    cost: float
    parameters: int
    bands: int
    dispersion: float

    def term(self, kind: str) -> Term | None:
        """The term of a kind; None where there is none."""
        return next((term for term in self.terms if term.kind == kind), None)

    def density(self, frequency_hz: Array, period_s: float) -> Array:
        """Two-sided spectral density [unit^2/Hz] of samples so far apart."""
        white = self.terms[0].size ** 2
        total = white * (1.0 + 0.5 * (self.ratio - 1.0) * shape("tilt", frequency_hz, period_s))
        for term in self.terms[1:]:
            total = total + term.size**2 * shape(term.kind, frequency_hz, period_s, term.tau_s)
        return np.asarray(total)


def fit_terms(
    bands: "Bands", kinds: Sequence[str] = (), fixed: tuple[str, float] | None = None, fastest_s: float = 0.0
) -> NoiseFit:
    """Fit white noise with a tilt, and further terms.

    Parameters
    ----------
    bands : Bands
    kinds : sequence of str
        Of ``"flicker"``, ``"walk"``, ``"gauss-markov"``, each at most once.
    fixed : (kind, size), optional
        A further term of a size that is given: ``"flicker"`` or ``"walk"``.
    fastest_s : float
        Least correlation time of the Gauss-Markov term.

    Raises
    ------
    ValueError
        For fewer bands than parameters.
    """
    problem = _Problem(bands, kinds, fixed, fastest_s)
    if bands.power.size <= problem.size:
        raise ValueError(f"{bands.power.size} bands of frequency are too few for {problem.size} parameters.")
    found = min((_descend(problem, start) for start in _starts(problem)), key=lambda one: float(one.fun))
    return _read(problem, found.x, float(found.fun))


class _Problem:
    """Minus the logarithm of the likelihood of bands, over ln N^2, ln of the ratio, and ln size^2 (and ln tau) of each
    further term.
    """

    def __init__(self, bands: "Bands", kinds: Sequence[str], fixed: tuple[str, float] | None, fastest_s: float) -> None:
        self.bands, self.kinds = bands, tuple(kinds)
        self.shapes = {kind: bands.mean(kind) for kind in ("white", "tilt", "flicker", "walk")}
        self.given = 0.0 if fixed is None else fixed[1] ** 2 * self.shapes[fixed[0]]
        self.taus = (max(FEW / bands.rate_hz, fastest_s), SHARE * bands.longest_s)
        self.size = 2 + sum(2 if kind == "gauss-markov" else 1 for kind in self.kinds)

    def markov(self, log_tau: float) -> Array:
        """Density of a Gauss-Markov term of size one in each band."""
        return self.bands.mean("gauss-markov", math.exp(log_tau))

    def model(self, at: Array) -> tuple[Array, Array]:
        """Density in each band, and its derivatives by the parameters."""
        white, ratio, k = math.exp(at[0]), math.exp(at[1]), 2
        plateau = white * (1.0 + 0.5 * (ratio - 1.0) * self.shapes["tilt"])
        slopes = [plateau, 0.5 * white * ratio * self.shapes["tilt"]]
        total = plateau + self.given
        for kind in self.kinds:
            if kind == "gauss-markov":
                part, ahead = (math.exp(at[k]) * self.markov(at[k + 1] + step) for step in (0.0, 1e-5))
                slopes += [part, (ahead - part) / 1e-5]
                k += 2
            else:
                part = math.exp(at[k]) * self.shapes[kind]
                slopes.append(part)
                k += 1
            total = total + part
        return total, np.array(slopes)

    def cost(self, at: Array) -> tuple[float, Array]:
        """The function to make small, and its gradient."""
        total, slopes = self.model(at)
        ratio, half = self.bands.power / total, 0.5 * self.bands.count
        return float(half @ (np.log(total) + ratio)), slopes @ (half * (1.0 - ratio) / total)

    def information(self, at: Array) -> Array:
        """Fisher's information."""
        total, slopes = self.model(at)
        scaled = slopes * np.sqrt(0.5 * self.bands.count) / total
        return np.asarray(scaled @ scaled.T)

    def bounds(self, start: Array) -> list[tuple[float, float]]:
        """Of the search."""
        bounds = [(value - FAR, value + FAR) for value in start]
        bounds[1] = (-8.0, 14.0)
        if "gauss-markov" in self.kinds:
            k = 3 + self.kinds.index("gauss-markov")
            bounds[k] = (math.log(self.taus[0]), math.log(self.taus[1]))
        return bounds


def _starts(problem: _Problem) -> list[Array]:
    """The plateau from the quietest bands, the rest from what stands above it at low frequencies."""
    bands = problem.bands
    quietest = np.argsort(bands.power * (1.0 + 3.0 / np.sqrt(bands.count)))[: max(3, bands.power.size // 3)]
    white = float(np.median(bands.power[quietest]))
    taus = np.geomspace(problem.taus[0], problem.taus[1], 7)[1:-1]
    starts = []
    for share in (0.5, 0.02):
        for tau in taus if "gauss-markov" in problem.kinds else (1.0,):
            at = [math.log(white), 0.0]
            for kind in problem.kinds:
                part = problem.markov(math.log(tau)) if kind == "gauss-markov" else problem.shapes[kind]
                at.append(math.log(max(share * float(np.median(bands.power[:6] / part[:6])), 1e-300)))
                at += [math.log(tau)] if kind == "gauss-markov" else []
            starts.append(np.array(at))
    return starts


def _descend(problem: _Problem, start: Array) -> optimize.OptimizeResult:
    bounds = problem.bounds(start)
    low, high = np.array(bounds).T
    begin, how = np.clip(start, low, high), {"maxiter": 500, "ftol": 1e-13}
    return optimize.minimize(problem.cost, begin, jac=True, method="L-BFGS-B", bounds=bounds, options=how)


def _read(problem: _Problem, at: Array, cost: float) -> NoiseFit:
    bands = problem.bands
    dispersion = _dispersion(bands, problem.model(at)[0], problem.size)
    covariance = np.linalg.pinv(problem.information(at)) * dispersion
    sd = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    sizes = np.exp(0.5 * at)
    terms, k = [Term("white", float(sizes[0]), float(0.5 * sd[0] * sizes[0]))], 2
    for kind in problem.kinds:
        tau = math.exp(at[k + 1]) if kind == "gauss-markov" else math.nan
        terms.append(Term(kind, float(sizes[k]), float(0.5 * sd[k] * sizes[k]), tau))
        k += 2 if kind == "gauss-markov" else 1
    white, ratio = math.exp(at[0]), math.exp(at[1])
    slope = np.array([white * (ratio - 1.0), white * ratio])
    rise = white * (ratio - 1.0), math.sqrt(max(float(slope @ covariance[:2, :2] @ slope), 0.0))
    counts = problem.size, bands.power.size
    return NoiseFit(tuple(terms), ratio, *rise, float(bands.high.max()), cost, *counts, dispersion)


def _dispersion(bands: "Bands", model: Array, parameters: int) -> float:
    """Deviance of the bands over what it is by chance; 1 where chance explains it."""
    ratio, half = bands.power / model, 0.5 * bands.count
    deviance = float(np.sum(2.0 * half * (ratio - 1.0 - np.log(ratio))))
    free = bands.power.size - parameters
    # mean of n (u - 1 - ln u) for u a chi-square over n
    usual = float(np.mean(2.0 * half * (np.log(half) - special.digamma(half))))
    return max(deviance / (usual * free), 1.0) if stats.chi2.sf(deviance / usual, free) < SURPRISE else 1.0


# --- the spectrum that the terms are fitted to -----------------------------------------------------------------------


def shape(kind: str, frequency_hz: Array, period_s: float, tau_s: float = math.nan) -> Array:
    """Two-sided spectral density of a sampled term of size one [1/Hz].

    Parameters
    ----------
    kind : {"white", "tilt", "flicker", "walk", "gauss-markov"}
        The tilt is zero at zero frequency and 2 at the Nyquist frequency.
    frequency_hz : ndarray
    period_s : float
        Of the samples.
    tau_s : float
        Of the Gauss-Markov term.
    """
    sine = np.sin(np.pi * np.asarray(frequency_hz) * period_s)
    if kind == "white":
        return np.ones_like(sine)
    if kind == "tilt":
        return np.asarray(2.0 * sine**2)
    if kind == "flicker":
        return np.asarray(period_s / (2.0 * sine))
    if kind == "walk":
        return np.asarray(period_s**2 / (4.0 * sine**2))
    fading = math.exp(-period_s / tau_s)
    gone = -math.expm1(-period_s / tau_s)
    return np.asarray(period_s * gone * (1.0 + fading) / (gone**2 + 4.0 * fading * sine**2))


@dataclass(frozen=True, eq=False)
class Bands:
    """Power of a series in bands of frequency.

    Attributes
    ----------
    power : ndarray, shape (m,)
        Mean two-sided spectral density in each band [unit^2/Hz].
    low, high : ndarray, shape (m,)
        Its lowest and highest frequency [Hz].
    count : ndarray, shape (m,)
        Coefficients in it: degrees of freedom.
    rate_hz : float
        Of the samples.
    """

    power: Array
    low: Array
    high: Array
    count: Array
    rate_hz: float

    def below(self, frequency_hz: float) -> "Bands":
        """The bands up to a frequency."""
        keep = self.high <= frequency_hz
        return Bands(self.power[keep], self.low[keep], self.high[keep], self.count[keep], self.rate_hz)

    def mean(self, kind: str, tau_s: float = math.nan) -> Array:
        """Density of a term of size one in each band, by Simpson's rule."""
        low, middle, high = (
            shape(kind, at, 1.0 / self.rate_hz, tau_s) for at in (self.low, 0.5 * (self.low + self.high), self.high)
        )
        return np.asarray((low + 4.0 * middle + high) / 6.0)

    @property
    def longest_s(self) -> float:
        """Length of the longest stretch [s]."""
        return 0.5 / float(self.low.min())


def bands_of(stretches: Sequence[Array], rate_hz: float, leave_out: Sequence[tuple[float, float]] = ()) -> Bands:
    """Bands of one or several stretches of a series, each of which has a level of its own.

    Parameters
    ----------
    stretches : sequence of ndarray, shape (n,)
        Samples without gaps.
    rate_hz : float
    leave_out : sequence of (low, high)
        Frequencies that do not count, such as lines [Hz].
    """
    rows = [row for x in stretches for row in _bands_of_one(x, rate_hz, leave_out)]
    power, low, high, count = np.array(rows).T
    return Bands(power, low, high, count, rate_hz)


def _bands_of_one(
    x: Array, rate_hz: float, leave_out: Sequence[tuple[float, float]]
) -> list[tuple[float, float, float, float]]:
    density = fft.dct(x - x.mean(), norm="ortho")[1:] ** 2 / rate_hz
    frequency = np.arange(1, x.size) * (0.5 * rate_hz / x.size)
    keep = np.ones(frequency.size, dtype=bool)
    for begin, end in leave_out:
        keep[(frequency >= begin) & (frequency <= end)] = False
    grid = np.arange(int(PER_DECADE * math.log10(x.size)) + 1) / PER_DECADE
    edges = np.unique(np.r_[np.round(10.0**grid).astype(np.int64), x.size])
    rows = []
    for first, after in itertools.pairwise(edges.tolist()):
        inside = np.flatnonzero(keep[first - 1 : after - 1]) + first - 1
        if inside.size:
            rows.append(
                (float(density[inside].mean()), frequency[inside[0]], frequency[inside[-1]], float(inside.size))
            )
    return rows
