"""The noise sheet of an inertial unit: what a data sheet says, from a record at rest, with uncertainties.

The noise of an inertial axis at rest as a sum of terms, fitted to its spectrum by likelihood.

Each band of coefficients (see `navfilter.identification.noise_sheet`) is a chi-square about its expectation, and
the curvature of the likelihood is the uncertainty.
"""

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import fft, ndimage, optimize, signal, special, stats

from navfilter.foundation.arrays import Array
from navfilter.foundation.constants import STANDARD_GRAVITY
from navfilter.foundation.display import Shown
from navfilter.identification.conditioning import quantisation_step
from navfilter.identification.static_detection import bridged_rest, moving_together, stillness, without_defects
from navfilter.io.inertial import ImuRecord
from navfilter.models.mechanisation import ACCEL_USUAL, GYRO_USUAL
from navfilter.timeseries.diagnostics import allan_deviation, allan_edf

#: How far a logarithm may go from where the search begins.
FAR_BOUNDS = 40.0
#: A Gauss-Markov term lives longer than so many samples and shorter than this share of the record, or it is another
#: term.
FEW, SHARE = 3.0, 0.5
#: A fit whose bands scatter more than chance does once in a hundred records is not complete.
SURPRISE = 0.01
#: Bands per decade of frequency.
LAGS_PER_DECADE = 12


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
        bounds = [(value - FAR_BOUNDS, value + FAR_BOUNDS) for value in start]
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
    grid = np.arange(int(LAGS_PER_DECADE * math.log10(x.size)) + 1) / LAGS_PER_DECADE
    edges = np.unique(np.r_[np.round(10.0**grid).astype(np.int64), x.size])
    rows = []
    for first, after in itertools.pairwise(edges.tolist()):
        inside = np.flatnonzero(keep[first - 1 : after - 1]) + first - 1
        if inside.size:
            rows.append(
                (float(density[inside].mean()), frequency[inside[0]], frequency[inside[-1]], float(inside.size))
            )
    return rows


Say = Callable[[str], Any]

#: A gyro whose mean differs by more from one stretch to another turns [rad/s]: no bias changes by half a degree a
#: second.
MOST_TURN = 0.01
#: Lines that are kept, the strongest.
MOST_LINES = 12
#: Records shorter than this say little of what is slow [s].
SHORT_S = 1800.0
#: Averages per decade.
PER_DECADE = 8
#: Probability of an error bar: one standard deviation.
ONE_SIGMA = 0.6827
#: The lowest point needs so many degrees of freedom.
LEAST_EDF = 3.0
#: Samples of a segment at most, and segments at least.
SEGMENT, SEGMENTS = 16384, 8
#: Frequencies around a line that give its background; lines are not looked for among the lowest.
AROUND, LOWEST = 101, 12
#: Probability of finding a line in white noise; a line stands above its background by this factor at least, which no
#: slope or filter of a unit does within a few frequencies.
FALSE_ALARM, ABOVE = 1e-3, 1.6
#: A broader rise than this share of its frequency is no line.
BROAD = 0.05
#: A term is shown where it raises twice the logarithm of the likelihood by so much: one false term in 140 records,
#: because half of the records without it would have it negative.
SHOWN = 6.0
#: By so much it falls at the upper limit of 95 %, on one side.
LIMIT = 2.71
#: Highest frequencies that are tried, in shares of the Nyquist frequency, and by how much the density of bands may
#: depart from the terms before a narrower range is tried.
SHARES, DEPARTURE = (1.0, 0.5, 0.25, 0.125, 0.0625), 0.05
#: The lower frequencies decide; more of them than this are always kept.
LEAST_BANDS = 15
#: How the upper limit of a logarithm is looked for.
STEP, FAR = 1.0, 30.0
#: A bias that fades faster is no state of a filter [s]: what integrates the drive over minutes, as the learner does,
#: would take it for a walk (`GaussMarkov.integrated`).
FASTEST_S = 100.0


class NotAtRest(ValueError):
    """No part of a record is at rest for long enough."""

    code = "not-at-rest"


@dataclass(frozen=True, eq=False)
class AxisSheet:
    """One axis, in rad/s or m/s^2.

    Attributes
    ----------
    name : str
        ``gyro_x`` ... ``accel_z``.
    level : float
        Mean of the longest stretch: of a gyro its bias and its share of the Earth's rate.
    sheet, drive : NoiseFit
        White noise, flicker and walk (IEEE 952); and what a filter has states for: white noise, Gauss-Markov, walk.
    limits : dict of str to float
        Largest sizes, at 95 %, of the terms of the sheet that do not show (``"flicker"``, ``"walk"``), and of the walk
        beside the terms of the drive (``"drive"``); NaN where the record sets none.
    quantisation, quantisation_sd : float
        Of the angle or the velocity [unit s]; NaN where there is no such rise towards high frequencies.
    step : float
        Rounding of the samples; 0 if none is seen.
    lines : tuple of Line
    allan : AllanCurve
    bands : Bands
        All, also those above what was fitted.
    notes : tuple of str
    """

    name: str
    level: float
    sheet: NoiseFit
    drive: NoiseFit
    limits: dict[str, float]
    quantisation: float
    quantisation_sd: float
    step: float
    lines: "tuple[Line, ...]"
    allan: "AllanCurve"
    bands: Bands
    notes: tuple[str, ...]

    @property
    def is_gyro(self) -> bool:
        """A gyro, or an accelerometer."""
        return self.name.startswith("gyro")


@dataclass(frozen=True, eq=False, repr=False)
class NoiseSheet(Shown):
    """What was found of an inertial unit.

    Attributes
    ----------
    source : str
    rate_hz, duration_s : float
        Of the record.
    stretches_s : tuple of (begin, end)
        Parts at rest that were used, in seconds from the beginning of the record.
    share : float
        Their share of the record.
    axes : tuple of AxisSheet
    moving : tuple of str
        Signs that the unit was not at rest after all.
    remarks : tuple of str
    """

    source: str
    rate_hz: float
    duration_s: float
    stretches_s: tuple[tuple[float, float], ...]
    share: float
    axes: tuple[AxisSheet, ...]
    moving: tuple[str, ...]
    remarks: tuple[str, ...]

    def _shown(self) -> tuple[str, dict[str, object]]:
        rows: dict[str, object] = {"record": f"{self.duration_s:.0f} s, {self.rate_hz:.4g} Hz", "verdict": self.verdict}
        rows |= {"axes": ", ".join(axis.name for axis in self.axes), "remarks": " ".join(self.remarks) or None}
        return f"NoiseSheet of {self.source}", rows

    @property
    def verdict(self) -> str:
        """Whether the record is at rest, in one sentence."""
        if self.moving:
            return "NOT AT REST: " + "; ".join(self.moving) + ". The figures are those of unit and motion together."
        parts = ", ".join(f"{begin:.0f} to {end:.0f} s" for begin, end in self.stretches_s[:6])
        parts += f" and {len(self.stretches_s) - 6} more" if len(self.stretches_s) > 6 else ""
        if self.share > 0.999:
            return f"at rest throughout ({self.duration_s:.0f} s)."
        return f"at rest for {100 * self.share:.1f} % of {self.duration_s:.0f} s, and only that is used: {parts}."


def noise_sheet(record: ImuRecord, say: Say | None = None) -> NoiseSheet:
    """Find the noise of an inertial unit from a record that is at rest, at least in parts.

    Parameters
    ----------
    record : ImuRecord
    say : callable, optional
        Told in a few words what is being done.

    Returns
    -------
    NoiseSheet

    Raises
    ------
    NotAtRest
        Where no part of the record is at rest for half a minute.
    ValueError
        Where an axis is constant.
    """
    say = say or (lambda text: None)
    say("looking for rest")
    samples, notes = without_defects(record.value)
    turn = np.array([MOST_TURN if name.startswith("gyro") else math.inf for name in record.names])
    found = stillness(samples, record.rate_hz, turn)
    if not found.stretches:
        raise NotAtRest(
            f"{record.source}: not at rest: no stretch of half a minute in {len(samples) / record.rate_hz:.0f} s in"
            " which all axes are as quiet as in the quietest quarter of the record. A noise sheet takes a record of the"
            " unit lying still, of an hour or more if it is to show the bias instability."
        )
    longest = max(found.stretches, key=lambda stretch: stretch[1] - stretch[0])
    whole = {
        name: [bridged_rest(samples[a:b, k], found.disturbed[a:b]) for a, b in found.stretches]
        for k, name in enumerate(record.names)
    }
    steps = {name: quantisation_step(record.value[longest[0] : longest[1], k]) for k, name in enumerate(record.names)}
    axes = []
    for name, stretches in whole.items():
        say(f"fitting {name}")
        axes.append(_axis(name, stretches, record.rate_hz, steps[name]))
    moving = _moving(whole, axes, found.stretches.index(longest), record.rate_hz)
    seconds = tuple((a / record.rate_hz, b / record.rate_hz) for a, b in found.stretches)
    remarks = (*record.notes, *notes, *_remarks(axes, seconds))
    return NoiseSheet(
        record.source, record.rate_hz, len(samples) / record.rate_hz, seconds, found.share, tuple(axes), moving, remarks
    )


# --- one axis -------------------------------------------------------------------------------------------------------


def _axis(name: str, stretches: Sequence[Array], rate_hz: float, step: float) -> AxisSheet:
    longest = max(stretches, key=len)
    if np.ptp(longest) == 0.0:
        raise ValueError(f"{name} is constant ({longest[0]:g}): it has no noise to tell. Is it the right column?")
    lines = spectral_lines(stretches, rate_hz)
    bands = bands_of(stretches, rate_hz, [reach(line, longest.size / rate_hz) for line in lines])
    kept = usable(bands)
    sheet, drive = sheet_terms(kept), drive_terms(kept)
    limits = {kind: upper_limit(kept, sheet, kind) for kind in ("flicker", "walk") if sheet.term(kind) is None}
    if drive.term("walk") is None:
        limits["drive"] = upper_limit(kept, drive, "walk")
    angle, angle_sd = quantisation(sheet, 1.0 / rate_hz)
    notes = []
    if sheet.highest_hz < 0.45 * rate_hz:
        notes.append(f"fitted up to {sheet.highest_hz:.3g} Hz, above which the unit's own filter bends the spectrum")
    if sheet.dispersion > 1.0:
        notes.append(
            f"the terms do not explain all of the spectrum (its scatter is {math.sqrt(sheet.dispersion):.1f} times that"
            " of chance); the uncertainties are widened by as much"
        )
    if step > 0.0 and step**2 / 12.0 > 0.25 * float(np.mean(np.diff(longest) ** 2)) / 2.0:
        notes.append(f"the samples are rounded to {step:.3g}, which makes much of their noise")
    if len(lines) > MOST_LINES:
        notes.append(f"{len(lines)} lines, of which the {MOST_LINES} strongest are listed")
    allan = allan_curve(stretches, rate_hz, sheet)
    level = float(longest.mean())
    return AxisSheet(
        name, level, sheet, drive, limits, angle, angle_sd, step, lines[:MOST_LINES], allan, bands,
        tuple(notes),
    )  # fmt: skip


def quantisation(fit: NoiseFit, period_s: float) -> tuple[float, float]:
    """Q of IEEE 952 and its sd from the rise to the Nyquist frequency, which is 4 Q^2 / T; NaN where there is none."""
    if fit.rise < 3.0 * fit.rise_sd or fit.highest_hz < 0.45 / period_s:
        return math.nan, math.nan
    size = math.sqrt(0.25 * fit.rise * period_s)
    return size, 0.5 * size * fit.rise_sd / fit.rise


# --- the unit -------------------------------------------------------------------------------------------------------


def _moving(whole: dict[str, list[Array]], axes: Sequence[AxisSheet], longest: int, rate_hz: float) -> tuple[str, ...]:
    """Signs of motion: axes that move together, noise that no such unit has."""
    found = []
    gyro, accel = ([parts[longest] for name, parts in whole.items() if name.startswith(g)] for g in ("gyro", "accel"))
    if together := moving_together(gyro, accel, rate_hz):
        found.append(
            f"{together[0]} move together" + (f" (and {len(together) - 1} more pairs)" if together[1:] else "")
        )
    for axis in axes:
        most = (GYRO_USUAL if axis.is_gyro else ACCEL_USUAL).most_density
        if axis.sheet.terms[0].size > most:
            found.append(
                f"the noise of {axis.name} is {axis.sheet.terms[0].size / most:.1f} times what the worst units have"
            )
    return tuple(found)


def _remarks(axes: Sequence[AxisSheet], stretches_s: Sequence[tuple[float, float]]) -> list[str]:
    remarks = [f"{axis.name}: {note}" for axis in axes for note in axis.notes]
    longest = max(end - begin for begin, end in stretches_s)
    if longest < SHORT_S:
        remarks.append(
            f"the longest stretch at rest is {longest / 60:.3g} min: what is slower than a third of it does not show;"
            " an hour or more shows bias instability and walk"
        )
    force = [axis.level for axis in axes if not axis.is_gyro]
    if len(force) == 3:
        length = math.sqrt(sum(level**2 for level in force))
        apart = length - STANDARD_GRAVITY
        remarks.append(
            f"the force at rest is {length:.4f} m/s^2, {1e3 * apart / STANDARD_GRAVITY:+.1f} mg from standard gravity"
            + (": beyond the biases of most units, so a scale or a unit is wrong" if abs(apart) > 1.0 else "")
        )
    return remarks


# --- the Allan deviation with error bars -----------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class AllanCurve:
    """Overlapping Allan deviation with error bars of one standard deviation.

    Attributes
    ----------
    tau_s, deviation, low, high, edf : ndarray, shape (m,)
        Averaging time, deviation and its bounds [unit], equivalent degrees of freedom.
    model : ndarray, shape (m,)
        Deviation of the fitted terms; NaN at times shorter than the frequencies that were fitted.
    """

    tau_s: Array
    deviation: Array
    low: Array
    high: Array
    edf: Array
    model: Array

    @property
    def lowest(self) -> int:
        """Place of the least deviation among those that are known."""
        known = self.edf >= min(LEAST_EDF, float(self.edf.max()))
        return int(np.argmin(np.where(known, self.deviation, np.inf)))

    @property
    def has_floor(self) -> bool:
        """Whether the deviation rises again behind its least value, by more than chance."""
        k = self.lowest
        return bool(np.any(self.low[k + 1 :] > self.high[k]))


def allan_curve(stretches: Sequence[Array], rate_hz: float, fit: NoiseFit) -> AllanCurve:
    """Of all stretches together, each weighted with its number of differences.

    Parameters
    ----------
    stretches : sequence of ndarray, shape (n,)
        Samples without gaps.
    rate_hz : float
    fit : NoiseFit
        Gives the degrees of freedom, and the deviation of the model.
    """
    longest = max(len(x) for x in stretches)
    top = math.log10(longest // 3)
    counts = np.unique(np.round(np.logspace(0.0, top, int(PER_DECADE * top) + 2)).astype(np.int64))
    total, weight, edf = (np.zeros(counts.size) for _ in range(3))
    for x in stretches:
        some = counts <= x.size // 3
        number = x.size - 2.0 * counts[some] + 1.0
        total[some] += number * allan_deviation(x, rate_hz, counts[some])[1] ** 2
        weight[some] += number
        edf[some] += allan_edf(counts[some], x.size, lambda f: fit.density(f, 1.0 / rate_hz), rate_hz)
    deviation = np.sqrt(total / weight)
    low, high = (deviation * np.sqrt(edf / stats.chi2.ppf(0.5 + sign * ONE_SIGMA / 2.0, edf)) for sign in (1.0, -1.0))
    return AllanCurve(counts / rate_hz, deviation, low, high, edf, _model_allan(fit, counts, rate_hz))


def _model_allan(fit: NoiseFit, counts: NDArray[np.int64], rate_hz: float) -> Array:
    """Allan deviation of the terms of IEEE 952, as sampled."""
    period, tau = 1.0 / rate_hz, counts / rate_hz
    white = fit.terms[0].size ** 2
    # of the tilt: that of quantisation, 3 Q^2 / tau^2
    variance = white / tau + 0.75 * white * (fit.ratio - 1.0) * period / tau**2
    if walk := fit.term("walk"):
        variance = variance + walk.size**2 * (2.0 * counts**2 + 1.0) / (6.0 * counts) * period
    if flicker := fit.term("flicker"):
        variance = variance + flicker.size**2 * 2.0 * math.log(2.0) / math.pi
    fitted = tau >= 0.45 / fit.highest_hz
    return np.where(fitted, np.sqrt(np.maximum(variance, 0.0)), np.nan)


# --- lines of the spectrum -------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Line:
    """A spectral line.

    Attributes
    ----------
    frequency_hz, width_hz : float
        Where it is strongest, and within how much it was found (at least the resolution).
    amplitude, sd : float
        Of a sine of the same power [unit], and how uncertain.
    density : float
        Two-sided density of the noise around it [unit^2/Hz].
    """

    frequency_hz: float
    width_hz: float
    amplitude: float
    sd: float
    density: float


def spectral_lines(stretches: Sequence[Array], rate_hz: float) -> tuple[Line, ...]:
    """The lines of a series, the strongest first.

    Parameters
    ----------
    stretches : sequence of ndarray, shape (n,)
        Samples without gaps; the longest is looked at.
    rate_hz : float
    """
    x = max(stretches, key=len)
    size = min(SEGMENT, 2 * x.size // (SEGMENTS + 1))
    if size < 4 * AROUND:
        return ()
    frequency, power = signal.welch(x, rate_hz, nperseg=size)
    background = ndimage.median_filter(power, AROUND, mode="nearest")
    # 50 % overlap with Hann's window: each pair of segments is as good as 1.9 of them
    free = 1.9 * (2.0 * x.size / size - 1.0)
    limit = max(float(stats.chi2.isf(FALSE_ALARM / power.size, free)) / free, ABOVE)
    # The median of a chi-square lies below its mean.
    background = background * free / float(stats.chi2.median(free))
    high = power > limit * background
    # at the Nyquist frequency there are fewer degrees of freedom
    high[:LOWEST], high[-6:] = False, False
    places = np.flatnonzero(high)
    runs = np.split(places, np.flatnonzero(np.diff(places) > 2) + 1) if places.size else []
    found = [_line(run, frequency, power, background, x.size / rate_hz, free) for run in runs]
    return tuple(sorted((line for line in found if line is not None), key=lambda line: -line.amplitude))


def _line(
    run: NDArray[np.intp], frequency: Array, power: Array, background: Array, length_s: float, free: float
) -> Line | None:
    step = float(frequency[1])
    if (run[-1] - run[0]) * step > max(BROAD * float(frequency[run[0]]), 6.0 * step):
        return None
    wide = slice(max(run[0] - 2, 0), min(run[-1] + 3, power.size))
    above = power[wide] - background[wide]
    variance = max(float(above.sum()) * step, 0.0)
    peak = int(run[np.argmax(power[run])])
    # one-sided to two-sided
    density = 0.5 * float(background[peak])
    middle = float(frequency[wide] @ np.maximum(above, 0.0) / np.maximum(above, 0.0).sum())
    width = max((run[-1] - run[0]) * step, step)
    amplitude = math.sqrt(2.0 * variance)
    # of a sine in white noise, and of the background that was taken off the bins
    bins = step * 2.0 * density * math.sqrt(2.0 * above.size / free)
    sd = math.hypot(math.sqrt(2.0 * density / length_s), bins / max(amplitude, 1e-300))
    return Line(middle, width, amplitude, sd, density)


def reach(line: Line, length_s: float) -> tuple[float, float]:
    """Frequencies over which a line spoils the spectrum of a record that ends within one of its periods [Hz].

    Parameters
    ----------
    line : Line
    length_s : float
        Of the record.
    """
    # Amplitude of the coefficient m places beside the line: A sqrt(n / 2) / (pi m); it should be lost in the noise.
    places = 3.0 * line.amplitude * math.sqrt(length_s / line.density) / math.pi
    half = 0.5 * line.width_hz + (places + 4.0) * 0.5 / length_s
    half = max(half, 1.5 * line.width_hz)
    return line.frequency_hz - half, line.frequency_hz + half


# --- which terms a record tells --------------------------------------------------------------------------------------


def usable(bands: Bands) -> Bands:
    """The bands below the frequency at which the unit's own filter begins to bend the spectrum otherwise than the terms
    can.
    """
    kept = bands
    for share in SHARES:
        below = bands.below(share * 0.5 * bands.rate_hz * (1.0 + 1e-9))
        if below.power.size < LEAST_BANDS:
            break
        kept = below
        fit = fit_terms(kept, ("flicker", "walk"))
        middle = 0.5 * (kept.low + kept.high)
        apart = np.abs(np.log(kept.power / fit.density(middle, 1.0 / kept.rate_hz)))
        beyond = np.maximum(apart - 2.5 * np.sqrt(2.0 / kept.count), 0.0)[kept.count > 30.0]
        if beyond.size == 0 or float(np.sqrt(np.mean(beyond**2))) < DEPARTURE:
            break
    return kept


def sheet_terms(bands: Bands) -> NoiseFit:
    """White noise, and flicker and walk as far as they show."""
    best = fit_terms(bands)
    for kinds in (("flicker",), ("walk",), ("flicker", "walk")):
        found = fit_terms(bands, kinds)
        if 2.0 * (best.cost - found.cost) / found.dispersion > SHOWN * (found.parameters > best.parameters):
            best = found
    return best


def drive_terms(bands: Bands) -> NoiseFit:
    """White noise, with the Gauss-Markov term and the walk that a filter can have as states, by Schwarz's criterion."""
    choices = [(), ("walk",)]
    if 0.25 * bands.longest_s > FASTEST_S:
        choices += [("gauss-markov",), ("gauss-markov", "walk")]
    fits = [fit_terms(bands, kinds, fastest_s=FASTEST_S) for kinds in choices]
    scale = min(fit.dispersion for fit in fits)
    return min(fits, key=lambda fit: 2.0 * fit.cost / scale + fit.parameters * math.log(fit.bands))


def upper_limit(bands: Bands, fit: NoiseFit, kind: str) -> float:
    """Largest size of a term, at 95 %, that a record does not contradict.

    Parameters
    ----------
    bands : Bands
    fit : NoiseFit
        Without that term.
    kind : {"flicker", "walk"}

    Returns
    -------
    float
        NaN where the likelihood has no such point.
    """
    kinds = tuple(term.kind for term in fit.terms[1:])
    with_it = fit_terms(bands, (*kinds, kind))
    base = min(fit.cost, with_it.cost)

    def rise(log_size: float) -> float:
        found = fit_terms(bands, kinds, (kind, math.exp(log_size)))
        return 2.0 * (found.cost - base) / fit.dispersion - LIMIT

    likeliest = next(term.size for term in with_it.terms if term.kind == kind)
    inside = math.log(max(likeliest, 1e-3 * _scale(bands, fit, kind)))
    beyond = inside
    while rise(beyond) < 0.0 and beyond < inside + FAR:
        beyond += STEP
    if not rise(inside) < 0.0 < rise(beyond):
        return math.nan
    return math.exp(float(optimize.brentq(rise, beyond - STEP, beyond, xtol=0.02)))


def _scale(bands: Bands, fit: NoiseFit, kind: str) -> float:
    """The size at which the term would be as strong as all others in the lowest band."""
    lowest = int(np.argmin(bands.low))
    others = fit.density(bands.low, 1.0 / bands.rate_hz)[lowest]
    return math.sqrt(float(others / bands.mean(kind)[lowest]))
