"""The error model that is learnt while the vehicle moves, and how its states follow a change of the model.

The same description of a sensor with its quick errors, and its slow ones, larger or smaller by a factor.
"""

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from navfilter.models.error_models import (
    Block,
    ErrorModel,
    GaussMarkov,
    Integrated,
    RandomWalk,
    Sum,
    White,
    block_level,
    joined_block,
    sum_of,
)
from navfilter.models.spectrum import Spectrum
from navfilter.models.window_limits import least_window
from navfilter.timeseries.model import ArmaModel
from navfilter.timeseries.stationary import stationary_covariance

#: Orders (p, q) of the fast part tried by default: white, Gauss-Markov, both, up to two oscillations with white noise.
DEFAULT_ORDERS = ((0, 0), (1, 0), (1, 1), (2, 0), (2, 1), (2, 2), (3, 2), (4, 2), (4, 3))
#: The window counts as this long at most where slow and fast errors are told apart [s]: what a heading forgets.
LONGEST_SPAN_S = 500.0
#: Colour is described as quick if its correlation time is shorter than this part of the window's span [1].
QUICKER = 200.0
#: A description is believed within this factor at best [1]: the axes of one instrument differ by as much.
LEAST_FACTOR = 1.1


@dataclass(frozen=True)
class LearnedArma(ErrorModel):
    """ARMA error whose order and coefficients are learnt under way, on a sliding window of the sensor's own readings.

    What is learnt is a posterior: a fast ARMA part, and a slow part of which the readings tell little, so that its
    prior counts. The filter carries both, the slow part with the variance that its posterior has.

    Parameters
    ----------
    prior : ErrorModel, optional
        What is believed beforehand, and in force until the first model has been learnt, beside as much white noise as
        what is slow in it is large: it may be quick. The slow part's standard deviation is believed within a factor of
        two, its time constant hardly (`navfilter.learning.slow_prior.SlowPrior`); beside white noise alone a slow error
        is unlikely. It stays a hypothesis beside what is learnt (`navfilter.learning.mixture`). Default: that of the
        sensor's kind.
    orders : sequence of (p, q)
        Candidates of the fast part.
    window : int
        Samples behind an estimate.
    hop : int, optional
        A model is adopted after so many samples at the soonest, default half the window; fewer while that fills.
    model : ArmaModel, optional
        The fast part in force; the navigator sets it when it adopts one.
    slow : ErrorModel, optional
        What is in force beside it: one or two Gauss-Markov processes, and white noise where the error may be white, or
        is described so.
    frozen : bool
        Keep `model` and learn nothing more: what one dive has taught, used on the next.
    spectrum : Spectrum, optional
        Of the whole error, with its uncertainty; for reports. It is not written to files, and not compared.
    prior_within : (float, float), optional
        Factors within which the standard deviation and the correlation time of `prior` are believed, one standard
        deviation of their logarithms; the slow part is then as large and as slow as described. For a sensor whose slow
        error is known: a drift hides it, and what is not known of it is carried as an error that may last. Default: a
        data sheet, which states the whole of an error; its slow part is believed to be 0.62 times as large, so that
        the mean of its variance is what is stated, and twice as slow, within (2, 7.4).

    level : float
        How many times as large as it was learnt the error is at present, as a variance and from one reading to the
        next; the navigator sets it. See `levels`.

    Raises
    ------
    ValueError
        For a window from which nothing could ever be learnt (below 103 samples, more for large orders), an empty or
        impossible list of orders, a model that is not stable, a slow part that is not Gauss-Markov, `slow` or `frozen`
        without a model, factors below 1.1, and `prior_within` without a prior whose error is coloured.

    Notes
    -----
    Whatever else is known of the sensor is added: ``White(sd=0.01) + LearnedArma()``, ``RandomWalk(1e-5) +
    LearnedArma()``.

    The states of the fast part are a register of past values, ``[n(t) .. n(t-p+1), e(t) .. e(t-q+1)]``, so that new
    coefficients leave them as they are, and a new order only appends or drops the oldest; those of the slow part
    follow.

    Examples
    --------
    >>> from navfilter import GaussMarkov, Heading
    >>> Heading(rate_hz=8, error=LearnedArma(prior=GaussMarkov(sd=0.01, tau_s=30))).models[0].block(0.125).size
    1
    """

    prior: ErrorModel | None = None
    orders: tuple[tuple[int, int], ...] = DEFAULT_ORDERS
    window: int = 4000
    hop: int | None = None
    model: ArmaModel | None = None
    slow: ErrorModel | None = None
    frozen: bool = False
    spectrum: Spectrum | None = field(default=None, compare=False)
    prior_within: tuple[float, float] | None = None
    level: float = 1.0

    if TYPE_CHECKING:  # what is handed over becomes what the fields are

        def __init__(
            self,
            prior: ErrorModel | None = None,
            orders: Sequence[tuple[int, int]] = DEFAULT_ORDERS,
            window: int = 4000,
            hop: int | None = None,
            model: ArmaModel | None = None,
            slow: ErrorModel | None = None,
            frozen: bool = False,
            spectrum: Spectrum | None = None,
            prior_within: Sequence[float] | None = None,
            level: float = 1.0,
        ) -> None: ...

    def __post_init__(self) -> None:
        super().__post_init__()
        try:
            orders = tuple(sorted({(int(p), int(q)) for p, q in self.orders}, key=lambda pq: (sum(pq), pq)))
        except (TypeError, ValueError):
            orders = ()
        if not orders or any(min(pq) < 0 or max(pq) > 10 for pq in orders):
            raise ValueError(
                f"LearnedArma.orders must be pairs (p, q) from 0 to 10, found {self.orders!r}. Example: ((1, 0), (2, "
                "1))."
            )
        object.__setattr__(self, "orders", orders)
        least = least_window(sum(orders[0]))
        if int(self.window) < least:
            raise ValueError(
                f"LearnedArma.window must be at least {least} samples for a model of order {orders[0]}, found "
                f"{self.window!r}: of fewer none is ever learnt. Typical: 4000."
            )
        if self.hop is not None and int(self.hop) < 1:
            raise ValueError(f"LearnedArma.hop must be at least 1 sample, found {self.hop!r}.")
        if self.prior is not None and (not isinstance(self.prior, ErrorModel) or learned_part(self.prior) is not None):
            raise ValueError(
                f"LearnedArma.prior must be a fixed error model, found {self.prior!r}. Example: GaussMarkov(sd=0.01, "
                "tau_s=30)."
            )
        if self.prior_within is not None:
            object.__setattr__(self, "prior_within", self._believed())
        if self.model is not None and not isinstance(self.model, ArmaModel):
            raise ValueError(
                f"LearnedArma.model must be an ArmaModel, found {self.model!r}. Example: ArmaModel([-0.8], [], 0.01)."
            )
        if self.model is not None and not self.model.is_stable:
            raise ValueError(
                f"LearnedArma.model must be stable, found a pole of radius {abs(self.model.poles).max():.6f}."
            )
        if any(not isinstance(part, GaussMarkov | White) for part in self.beside):
            raise ValueError(
                f"LearnedArma.slow must be Gauss-Markov processes, and white noise beside them, found {self.slow!r}. "
                "Example: GaussMarkov(sd=0.01, tau_s=60)."
            )
        if self.beside and self.model is None:
            raise ValueError(
                "LearnedArma(slow=...) has no model beside it. Give it one: ArmaModel([], [], sd) is white."
            )
        if not (math.isfinite(self.level) and self.level > 0.0):
            raise ValueError(f"LearnedArma.level must be positive, found {self.level!r}. As it was learnt it is 1.")
        if self.frozen and self.model is None:
            raise ValueError(
                "LearnedArma(frozen=True) has no model to keep. Give it one, or leave frozen out and it learns one."
            )

    def _believed(self) -> tuple[float, ...]:
        """The factors of `prior_within`, looked over."""
        try:
            factors = tuple(float(one) for one in self.prior_within or ())
        except (TypeError, ValueError):
            factors = ()
        if len(factors) != 2 or not all(LEAST_FACTOR <= one < math.inf for one in factors):
            raise ValueError(
                f"LearnedArma.prior_within must be two factors of at least {LEAST_FACTOR}, of the standard deviation "
                f"and of the correlation time, found {self.prior_within!r}. Example: (2, 3). What is known better "
                "need not be learnt."
            )
        parts = () if self.prior is None else self.prior.terms
        if all(isinstance(part, White | RandomWalk) for part in parts):
            raise ValueError(
                f"LearnedArma.prior_within says how far a slow error is believed, but the prior has none, found "
                f"{self.prior!r}. Give it one: GaussMarkov(sd=..., tau_s=...), or leave prior_within out."
            )
        return factors

    def block(self, period_s: float) -> Block:
        """Discretise: the model in force, else the prior.

        Raises
        ------
        ValueError
            When there is neither.
        """
        if self.model is not None:
            return _learnt_block(self.model, self.beside, period_s, self.levels(period_s))
        if self.prior is None:
            raise ValueError("LearnedArma needs a prior here: LearnedArma(prior=GaussMarkov(sd=..., tau_s=...)).")
        return self.prior.block(period_s)

    def in_force(self, period_s: float) -> Block:
        """Its block; while there is nothing but the prior, as much white noise beside it as its slow parts are large:
        how quick an error is nobody knows before readings show it. Parts that are described as quick are so already.

        Two of three readings of a second are believed too much where an error that was described to last for half a
        minute is quick: a depth gauge of 16 mm told a vertical velocity that was off by five of its standard
        deviations, and was refused from then on.
        """
        block = self.block(period_s)
        if self.model is not None or self.prior is None:
            return block
        added, quick_s = 0.0, min(self.window * period_s, LONGEST_SPAN_S) / QUICKER
        for part in self.prior.terms:
            one = part.block(period_s)
            if one.size and not isinstance(part, RandomWalk):
                variance, power = one.state_variance, 0.5 * (block_level(one) - one.r) * period_s
                added += variance if power >= quick_s * variance else 0.0
        return replace(block, r=block.r + added)

    def s0(self, period_s: float) -> float:
        """S(0) per sample of its block."""
        if self.model is not None:
            return _learnt_level(self.model, self.beside, period_s, self.levels(period_s))
        return block_level(self.block(period_s))

    def integrated(self, period_s: float) -> Integrated:
        """That of the prior while nothing has been learnt."""
        if self.model is None and self.prior is not None:
            return self.prior.integrated(period_s)
        return super().integrated(period_s)

    def levels(self, period_s: float) -> tuple[float, float]:
        """How many times as large as it was learnt the fast part is at present, with the white noise beside it, and the
        slow one, as variances.

        The level is that of what readings scatter by from one to the next. Either may have changed as much as the
        other: what is known of a sum of two tells of each by its share in it (least squares).
        """
        share = _slow_share(self.model, self.beside, period_s) if self.model is not None and self.level != 1.0 else 0.0
        if self.level < 1.0:  # the shares would go below nothing
            return self.level, self.level
        quick, slow = ((self.level - 1.0) * part / (share**2 + (1.0 - share) ** 2) for part in (1.0 - share, share))
        return 1.0 + quick, 1.0 + slow

    @property
    def beside(self) -> tuple[ErrorModel, ...]:
        """What stands beside the fast part: the slow one's processes, and white noise."""
        return () if self.slow is None else self.slow.terms

    @property
    def slow_parts(self) -> tuple[GaussMarkov, ...]:
        """The processes of the slow part."""
        return tuple(part for part in self.beside if isinstance(part, GaussMarkov))

    def __str__(self) -> str:
        if self.model is None:
            return f"LearnedArma(prior={self.prior})"
        slow = f" + {self.slow}" if self.slow is not None else ""
        return f"LearnedArma({self.model.p}, {self.model.q}{slow}{', frozen' if self.frozen else ''})"


@lru_cache(maxsize=64)
def _learnt_block(
    model: ArmaModel, beside: tuple[ErrorModel, ...], period_s: float, levels: tuple[float, float] = (1.0, 1.0)
) -> Block:
    # laying out the states asks for it some fifty times at each adoption
    blocks = [register_block(model), *(part.block(period_s) for part in beside)]
    sizes = [levels[0], *(levels[isinstance(part, GaussMarkov)] for part in beside)]
    return joined_block([Block(b.Phi, k * b.Q, b.C, k * b.r, k * b.P0) for b, k in zip(blocks, sizes, strict=True)])


@lru_cache(maxsize=64)
def _learnt_level(
    model: ArmaModel, beside: tuple[ErrorModel, ...], period_s: float, levels: tuple[float, float]
) -> float:
    return block_level(_learnt_block(model, beside, period_s, levels))


@lru_cache(maxsize=64)
def _slow_share(model: ArmaModel, beside: tuple[ErrorModel, ...], period_s: float) -> float:
    """Of what readings scatter by from one to the next, as a variance, what is the slow part's [1]."""
    of_slow, whole = (
        float(block.C @ block.Q @ block.C) + block.r
        for block in (
            joined_block([part.block(period_s) for part in beside if isinstance(part, GaussMarkov)]),
            _learnt_block(model, beside, period_s),
        )
    )
    return of_slow / whole


@lru_cache(maxsize=64)
def register_block(model: ArmaModel) -> Block:
    """Block of an ARMA model as a register of past values and innovations."""
    ar, variance = model.ar, model.sd**2
    p, q = model.p, model.q
    if p + q == 0:
        return Block(np.zeros((0, 0)), np.zeros((0, 0)), np.zeros(0), variance, np.zeros((0, 0)))
    k = max(p, 1)
    Phi, g = np.zeros((k + q, k + q)), np.zeros(k + q)
    Phi[0, :p], Phi[0, k:] = -ar, model.ma
    Phi[range(1, k), range(k - 1)] = 1.0
    Phi[range(k + 1, k + q), range(k, k + q - 1)] = 1.0
    g[0] = 1.0
    if q:
        g[k] = 1.0
    Q = variance * np.outer(g, g)
    return Block(Phi, Q, np.eye(k + q)[0], 0.0, stationary_covariance(Phi, Q))


def as_described(models: Sequence[ErrorModel]) -> tuple[ErrorModel, ...]:
    """Error models with the prior in place of a learnt part that has no model yet: nothing will be learnt."""
    described = []
    for model in models:
        part = learned_part(model)
        if part is not None and part.model is None and part.prior is not None:
            known = [one for one in model.terms if one is not part]
            model = sum_of([*known, *part.prior.terms])
        described.append(model)
    return tuple(described)


def changed(models: Sequence[ErrorModel], **fields: Any) -> tuple[ErrorModel, ...]:
    """Error models with other fields of what was learnt of them and goes on learning; the very same where nothing is
    another one.
    """
    parts = [learning_part(model) for model in models]
    now = [part if part is None or part.model is None else replace(part, **fields) for part in parts]
    if now == parts:
        return tuple(models)  # what it takes to adopt them has been worked out
    return tuple(model if new is None else with_learned(model, new) for model, new in zip(models, now, strict=True))


#: What stands in place of what was learnt where nothing is.
UNLEARNT: dict[str, Any] = {"model": None, "slow": None, "spectrum": None, "level": 1.0}


def register_labels(model: ArmaModel) -> list[tuple[str, int]]:
    """What the states of a register are: values n and innovations e by their age."""
    if model.p + model.q == 0:
        return []
    return [("n", i) for i in range(max(model.p, 1))] + [("e", i) for i in range(model.q)]


def learned_part(model: ErrorModel) -> LearnedArma | None:
    """The learnt part of an error model, or None.

    Raises
    ------
    ValueError
        When there are two: only their sum can be observed.
    """
    found = [part for part in model.terms if isinstance(part, LearnedArma)]
    if len(found) > 1:
        raise ValueError("an error model can hold one LearnedArma: of two only the sum can be observed.")
    return found[0] if found else None


def learning_part(model: ErrorModel) -> LearnedArma | None:
    """The part of an error model that goes on learning: as `learned_part`, but None where it is frozen."""
    part = learned_part(model)
    return None if part is None or part.frozen else part


def is_learnt(model: ErrorModel) -> bool:
    """Whether something that was learnt of it is in force."""
    part = learning_part(model)
    return part is not None and part.model is not None


def with_learned(model: ErrorModel, learned: LearnedArma) -> ErrorModel:
    """The same error model with another learnt part."""
    return sum_of([learned if isinstance(part, LearnedArma) else part for part in model.terms])


def resolve_prior(models: Sequence[ErrorModel], prior: ErrorModel) -> tuple[ErrorModel, ...]:
    """Error models with `prior` where a learnt part has neither prior nor model."""
    resolved = []
    for model in models:
        learned = learned_part(model)
        if learned is not None and learned.prior is None and learned.model is None:
            model = with_learned(model, replace(learned, prior=prior))
        resolved.append(model)
    return tuple(resolved)


def known_white(model: ErrorModel, period_s: float) -> float:
    """White variance of what stands beside the learnt part; 0 without one: nothing of a fixed model is known to be
    right.
    """
    if learned_part(model) is None:
        return 0.0
    return sum(part.block(period_s).r for part in model.terms if isinstance(part, White))


def known_walk(model: ErrorModel) -> float:
    """Root PSD of the random walks in a model: the bias of the sensor, which stays beside whatever is learnt."""
    return math.sqrt(sum(part.density**2 for part in model.terms if isinstance(part, RandomWalk)))


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
    for name in (part.name for part in dataclasses.fields(model) if part.name in _SIZES):  # type: ignore[arg-type]
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
