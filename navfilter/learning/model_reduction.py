"""What cannot be told from a bias of an inertial axis is added to its random walk."""

from __future__ import annotations

import numpy as np

from navfilter.foundation.arrays import Array
from navfilter.learning.arma_fit import Drift, fit_channel
from navfilter.models.error_models import ErrorModel, RandomWalk, sum_of
from navfilter.models.learned_arma import known_walk
from navfilter.timeseries.model import ArmaModel

#: A process that a series holds fewer times than this, by its time constant, may be its bias.
CYCLES = 10.0
#: Poles nearer to 1 than these parts of the series are the bias, with what the learner's own limit is short of 3.
#: Beyond `CYCLES` parts they may be.
SAME = 3.03


def hand_over(
    found: ArmaModel, model: ErrorModel, series: Array, drift: Drift, white: float
) -> tuple[ArmaModel, ErrorModel]:
    """Give poles that the window cannot tell from a bias to the random walk beside the learnt part.

    A pole nearer to 1 than three parts of the window and the bias of the same axis are one state: two would be adopted
    for what is one. One that forgets more slowly than in a tenth of the window may be: then the likelihood decides, and
    BIC, which has less to pay for a walk. The white noise that drives the pole's part of the process (partial fractions
    of the spectrum) is added to that of the random walk, and what is left is fitted with one pole and one zero less.

    Parameters
    ----------
    found : ArmaModel
        What was learnt.
    model : ErrorModel
        Of the axis, with at least one `RandomWalk`.
    series : ndarray, shape (n,)
        What it was learnt from.
    drift : Drift
        The known random walk.
    white : float
        Known white variance.

    Returns
    -------
    ArmaModel, ErrorModel
        Without such poles, and the model with the random walk that has taken them over.
    """
    known, period_s = drift.density[0], drift.period_s
    n = int(np.isfinite(series).sum())
    while (slow := _slow_pole(found, n)) is not None:
        wider = float(np.hypot(known, np.sqrt(max(_driving_variance(found, slow), 0.0) / period_s)))
        less = fit_channel(series, Drift((wider,), period_s), found.p - 1, max(found.q - 1, 0), white=white)
        if slow < 1.0 - SAME / n:
            own = fit_channel(series, Drift((known,), period_s), found.p, found.q, white=white, start=found, passes=0)
            if less.bic + np.log(n) > own.bic:
                break
        known, found = wider, less.model
    if known == drift.density[0]:
        return found, model
    first = next(part for part in model.terms if isinstance(part, RandomWalk))
    start = float(np.sqrt(first.block(period_s).P0[0, 0]))
    others = known_walk(model) ** 2 - first.density**2
    walk = RandomWalk(density=float(np.sqrt(max(known**2 - others, first.density**2))), start_sd=start)
    return found, sum_of([walk if part is first else part for part in model.terms])


def _slow_pole(model: ArmaModel, n: int) -> float | None:
    """The slowest real pole, if n samples may not tell it from a bias."""
    poles = model.poles
    near = poles[(np.abs(poles) > 1.0 - CYCLES / n) & (np.abs(np.angle(poles)) < SAME / n)]
    return float(np.max(np.abs(near))) if near.size else None


def _driving_variance(model: ArmaModel, pole: float) -> float:
    """Variance of the white noise that drives the part of a process with this real pole."""
    others = np.delete(model.poles, np.argmin(np.abs(model.poles - pole)))
    rest = np.atleast_1d(np.poly(others)).real

    def at(c: Array, z: float) -> float:
        return float(np.sum(c * z ** np.arange(len(c))))

    ma = np.r_[1.0, model.ma]
    return model.sd**2 * at(ma, pole) * at(ma, 1.0 / pole) / (at(rest, pole) * at(rest, 1.0 / pole))
