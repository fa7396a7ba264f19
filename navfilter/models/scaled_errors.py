"""The same description of a sensor with its quick errors, and its slow ones, larger or smaller by a factor."""

import dataclasses
import math
from dataclasses import replace
from typing import Any, NamedTuple

from navfilter.models.error_models import ErrorModel, RandomWalk, Sum, White, block_level, sum_of
from navfilter.models.learned_arma import LONGEST_SPAN_S, QUICKER, learned_part, with_learned
from navfilter.timeseries.model import ArmaModel

#: What lasts as long as this is slow [s]: the limit that a learner with a full window has.
SLOW_S = LONGEST_SPAN_S / QUICKER
#: The fields of error models that say how large they are, or are models that do.
_SIZES = ("sd", "density", "start_sd", "prior", "slow", "model")


class Parts(NamedTuple):
    """What a description of one axis consists of.

    Attributes
    ----------
    quick, slow : bool
        Whether it has such parts.
    white : float
        Standard deviation of the white noise that is believed beside slow parts alone [unit]: how quick an error is,
        such a description hardly knows. 0 where there are quick parts, or none that are stationary.
    """

    quick: bool
    slow: bool
    white: float


def parts_of(model: ErrorModel, period_s: float) -> Parts:
    """What there is to be scaled in the description of an axis.

    Parameters
    ----------
    model : ErrorModel
    period_s : float
        Of the sensor [s].

    Examples
    --------
    >>> from navfilter.models.error_models import GaussMarkov
    >>> parts_of(GaussMarkov(sd=0.02, tau_s=30.0), 1.0)
    Parts(quick=False, slow=True, white=0.02)
    """
    flat = _described(model)
    slow = [part for part in flat if _is_slow(part, period_s)]
    quick = len(slow) < len(flat)
    variance = sum(part.block(period_s).state_variance for part in slow if not isinstance(part, RandomWalk))
    return Parts(quick, bool(slow), 0.0 if quick else math.sqrt(variance))


def scaled(model: ErrorModel, period_s: float, quick: float = 1.0, slow: float = 1.0) -> ErrorModel:
    """The description of an axis with sizes that are larger by factors; time constants and shapes stay.

    Parameters
    ----------
    model : ErrorModel
        Of a learnt part it is the prior that is scaled.
    period_s : float
        Of the sensor [s].
    quick, slow : float
        Factors of the standard deviations. Where there are slow parts alone, white noise of `quick` times their size
        is added; 0 adds none.

    Returns
    -------
    ErrorModel

    Examples
    --------
    >>> from navfilter.models.error_models import GaussMarkov
    >>> scaled(White(sd=0.1) + GaussMarkov(sd=0.2, tau_s=60.0), 1.0, quick=2.0, slow=0.5)
    White(sd=0.2) + GaussMarkov(sd=0.1, tau_s=60.0)
    """
    return _scaled(model, period_s, quick, slow, quick * parts_of(model, period_s).white)


def larger(model: ErrorModel, factor: float) -> ErrorModel:
    """The same error, or sum of errors, so many times as large; of a learnt one what was learnt and its prior."""
    if isinstance(model, Sum):
        return Sum(tuple(larger(part, factor) for part in model.parts))
    new: dict[str, Any] = {}
    for name in (field.name for field in dataclasses.fields(model) if field.name in _SIZES):  # type: ignore[arg-type]
        value = getattr(model, name)
        if isinstance(value, ErrorModel):
            new[name] = larger(value, factor)
        elif isinstance(value, ArmaModel):
            new[name] = replace(value, sd=factor * value.sd)
        elif value is not None:
            new[name] = factor * value
    return model if factor == 1.0 or not new else replace(model, **new)  # type: ignore[type-var]


def _scaled(model: ErrorModel, period_s: float, quick: float, slow: float, white: float) -> ErrorModel:
    """The same with white noise of this size beside it, in the prior of a learnt part where there is one."""
    learned = learned_part(model)
    if learned is not None and learned.prior is not None:
        prior = _scaled(learned.prior, period_s, quick, slow, white)
        model, white = with_learned(model, replace(learned, prior=prior)), 0.0
    parts = [
        part if learned_part(part) is not None else larger(part, slow if _is_slow(part, period_s) else quick)
        for part in model.terms
    ]
    parts += [White(sd=white)] if white > 0.0 else []
    return sum_of(parts)


def _described(model: ErrorModel) -> list[ErrorModel]:
    """All parts, a learnt one by its prior."""
    found: list[ErrorModel] = []
    for part in model.terms:
        learned = learned_part(part)
        found += learned.prior.terms if learned is not None and learned.prior is not None else [part]
    return found


def _is_slow(part: ErrorModel, period_s: float) -> bool:
    """Whether a part lasts: a walk, or what has its variance at low frequencies, as `LearnedArma.in_force` asks."""
    if isinstance(part, RandomWalk):
        return True
    block = part.block(period_s)
    power = 0.5 * (block_level(block) - block.r) * period_s if block.size else 0.0
    return power >= SLOW_S * block.state_variance > 0.0
