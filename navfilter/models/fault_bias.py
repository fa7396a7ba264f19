"""Constants of sensors that have jumped: error models in force get them under way, and lose them again."""

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import TypeGuard

import numpy as np

from navfilter.foundation.arrays import Array, Ints
from navfilter.models.error_models import ErrorModel, Errors, RandomWalk, per_axis, sum_of

#: Iron turns a compass by no more than this [rad]: one that is off by more is mounted, or read, the wrong way round.
DEVIATES = math.radians(60.0)
#: By so much the distance of a velocity sensor may err [1]: twice the speed of sound set for fresh water at sea.
#: (derived)
SCALE = 0.05


@dataclass(frozen=True)
class FaultBias(RandomWalk):
    """A constant by which a sensor was found to be off while under way, beside its error model.

    Parameters
    ----------
    density : float
        0: it does not wander [unit/sqrt(s)].
    start_sd : float
        Standard deviation when it is put in force [unit].
    """

    density: float = 0.0
    start_sd: float | None = 0.0


@dataclass(frozen=True)
class FaultScale(FaultBias):
    """What a velocity sensor was found to be off by, as far as that is in proportion to the velocity: a scale of all
    axes that has jumped (another speed of sound) looks like a constant until the vehicle changes its speed.

    Parameters
    ----------
    at_m_s : float
        The state is the error at this speed [m/s].
    """

    at_m_s: float = 1.0


@dataclass(frozen=True)
class FaultDeviation(FaultBias):
    """What a compass was found to be off by, as far as that goes with the heading: iron that has come near it turns
    with the vehicle. Of one cycle (National Geospatial-Intelligence Agency, "Handbook of magnetic compass adjustment",
    2004).

    Parameters
    ----------
    of_rad : float
        The state is the error at this heading; it goes with the cosine of what the heading differs from it by [rad].
    """

    of_rad: float = 0.0


@dataclass(frozen=True)
class FaultCurrent(FaultBias):
    """What a velocity sensor was found to be off by, as far as that is a velocity in n of what it reads against: one
    that has lost the bottom sees the water, and fish, a plume or ice move, too. It goes with no turn of the vehicle.

    Parameters
    ----------
    component : int
        0: north, 1: east.
    """

    component: int = 0


@dataclass(frozen=True)
class FaultTurn(FaultBias):
    """What a velocity sensor was found to be off by, as far as it has been turned about the axis down: at a steady
    speed that looks like a constant to the side.

    Parameters
    ----------
    start_sd : float
        Of the angle [rad].
    """


@dataclass(frozen=True)
class FaultDescription(FaultBias):
    """By how much a velocity sensor was found to be described wrongly: no jump, for it has no beginning.

    Parameters
    ----------
    component : int
        0, 1, 2: its lever arm forward, to starboard, down [m]; 3: its clock, by which its stamps are late [s];
        4, 5, 6: its mounting about the forward, the starboard and the downward axis [rad].
    """

    component: int = 0

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.component not in range(7):
            raise ValueError(f"component must be 0 to 6, found {self.component!r}.")


def _has_jumped(part: ErrorModel) -> TypeGuard[FaultBias]:
    return isinstance(part, FaultBias) and not isinstance(part, FaultDescription)


def _plain(model: ErrorModel) -> ErrorModel:
    return sum_of([part for part in model.terms if not _has_jumped(part)])


def has_description(models: tuple[ErrorModel, ...]) -> bool:
    """Whether the error models of a sensor have a `FaultDescription`."""
    return any(isinstance(part, FaultDescription) for model in models for part in model.terms)


def has_offset(models: ErrorModel | tuple[ErrorModel, ...]) -> bool:
    """Whether the error models of a sensor, one for all axes or one per axis, have an `FaultBias` of a jump."""
    each = models if isinstance(models, tuple) else (models,)
    return any(_has_jumped(part) for model in each for part in model.terms)


def wanders(models: ErrorModel | tuple[ErrorModel, ...]) -> bool:
    """Whether a `FaultBias` among the error models of a sensor wanders: that of one that has jumped by about itself."""
    each = models if isinstance(models, tuple) else (models,)
    return any(_has_jumped(part) and part.density > 0.0 for model in each for part in model.terms)


def offset_states(models: tuple[ErrorModel, ...], period_s: float, only: int | None = None) -> Ints:
    """Which states of the error models of a sensor are its offsets, axis by axis, or of one axis only; empty where it
    has none.
    """
    found = [(axis, at) for axis, at, part in _places(models, period_s) if _has_jumped(part)]
    return np.array([at for axis, at in found if only in (None, axis)], dtype=np.int64)


def proportions(models: tuple[ErrorModel, ...], period_s: float) -> list[tuple[int, float]]:
    """State of each `FaultScale`, and the speed at which it is the error [m/s]."""
    return [(at, part.at_m_s) for _, at, part in _places(models, period_s) if isinstance(part, FaultScale)]


def deviations(models: tuple[ErrorModel, ...], period_s: float) -> tuple[Ints, Array]:
    """States of each `FaultDeviation`, shape (k,), and the heading at which it is the error [rad], shape (k,)."""
    found = [(at, part.of_rad) for _, at, part in _places(models, period_s) if isinstance(part, FaultDeviation)]
    table = np.array(found, dtype=np.float64).reshape(-1, 2)
    return table[:, 0].astype(np.int64), table[:, 1]


def currents(models: tuple[ErrorModel, ...], period_s: float) -> list[tuple[int, int]]:
    """State and component of each `FaultCurrent`."""
    return [(at, part.component) for _, at, part in _places(models, period_s) if isinstance(part, FaultCurrent)]


def descriptions(models: tuple[ErrorModel, ...], period_s: float) -> list[tuple[int, int]]:
    """State and component of each `FaultDescription`; of a `FaultTurn`, 6."""
    found = ((at, getattr(part, "component", 6), part) for _, at, part in _places(models, period_s))
    return [(at, component) for at, component, part in found if isinstance(part, FaultDescription | FaultTurn)]


def with_description(models: tuple[ErrorModel, ...], sds: Mapping[int, float]) -> tuple[ErrorModel, ...]:
    """Error models of a velocity sensor with these components of its description unknown by so much [m], [s], [rad]."""
    unknown = (FaultDescription(start_sd=sd, component=i) for i, sd in sds.items())
    return (sum(unknown, start=models[0]), *models[1:])


def _places(models: tuple[ErrorModel, ...], period_s: float) -> Iterator[tuple[int, int, ErrorModel]]:
    """The parts of all models: axis, first state, part."""
    at = 0
    for axis, model in enumerate(models):
        for part in model.terms:
            yield axis, at, part
            at += part.block(period_s).size


def with_offsets(
    models: tuple[ErrorModel, ...],
    size: float = 0.0,
    at_m_s: float = 0.0,
    density: float = 0.0,
    only: int | None = None,
    deviates: bool = False,
) -> tuple[ErrorModel, ...]:
    """Error models with an `FaultBias` of this standard deviation each, or of one axis only, which wanders with a
    density, and beside it what else the sensor may have: at a speed a `FaultScale`, and a `FaultCurrent` north and
    east; a `FaultDeviation` with the heading (two, where iron may do that). Without any where the size is 0. So
    explanations that cannot be told from each other yet are all carried, as states.

    Examples
    --------
    >>> from navfilter import White
    >>> str(with_offsets((White(sd=0.1),), 5.0)[0])
    'White(sd=0.1) + FaultBias(start_sd=5.0)'
    """
    plain = tuple(_plain(model) for model in models)
    if not size:
        return plain
    added: tuple[FaultBias, ...] = (FaultBias(density=density, start_sd=size),)
    if deviates and size <= DEVIATES:
        added += tuple(FaultDeviation(start_sd=size, of_rad=of_rad) for of_rad in (0.0, 0.5 * math.pi))
    opened = [sum(added, start=m) if only in (None, axis) else m for axis, m in enumerate(plain)]
    if at_m_s:
        flows = () if only is not None else [FaultCurrent(start_sd=size, component=i) for i in range(2)]
        of_all = FaultScale(start_sd=min(size, SCALE * at_m_s), at_m_s=at_m_s), *flows
        of_all = (*of_all, FaultTurn(start_sd=size / at_m_s)) if only is None else of_all
        opened[0] = sum(of_all, start=opened[0])
    return tuple(opened)


def described(
    models: Iterable[tuple[str, Errors]], axes: Mapping[str, int], others: Mapping[str, Errors]
) -> dict[str, Errors]:
    """Error models by sensor without the offsets of those that have so many axes; the rest stay what they are. Of what
    stands among the others, as it does there, those are taken.
    """
    plain = {
        name: others[name] if name in others else unfaulted(per_axis(e, axes[name], name)) if name in axes else e
        for name, e in models
    }
    return plain | dict(others)


def unfaulted(models: tuple[ErrorModel, ...]) -> tuple[ErrorModel, ...]:
    """Error models without anything that was found while under way."""
    return tuple(sum_of([part for part in model.terms if not isinstance(part, FaultBias)]) for model in models)


def with_the_same_offsets(new: tuple[ErrorModel, ...], old: tuple[ErrorModel, ...]) -> tuple[ErrorModel, ...]:
    """New error models with the offsets that the old ones have: who learns them knows nothing of offsets."""
    pairs = zip(unfaulted(new), old, strict=True)
    return tuple(sum((part for part in was.terms if isinstance(part, FaultBias)), start=model) for model, was in pairs)
