"""Which terms a record shows, up to which frequency they hold, and how large those may be that it does not show."""

from __future__ import annotations

import math

import numpy as np
from scipy import optimize

from navfilter.identification.cosine_spectrum import Bands
from navfilter.identification.noise_terms import NoiseFit, fit_terms

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
