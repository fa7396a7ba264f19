"""Constants of sensors that have jumped: error models in force get them under way, and lose them again."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from navfilter.error_models import ErrorModel, RandomWalk, Sum

__all__ = ["Offset", "has_offset", "offset_states", "with_offsets", "with_the_same_offsets"]


@dataclass(frozen=True)
class Offset(RandomWalk):
    """A constant by which a sensor was found to be off while under way, beside its error model.

    Parameters
    ----------
    density : float
        0: it does not wander.
    start_sd : float
        Standard deviation when it is put in force [unit].
    """

    density: float = 0.0
    start_sd: float | None = 0.0


def _parts(model: ErrorModel) -> tuple[ErrorModel, ...]:
    return model.parts if isinstance(model, Sum) else (model,)


def _plain(model: ErrorModel) -> ErrorModel:
    rest = [part for part in _parts(model) if not isinstance(part, Offset)]
    return sum(rest[1:], start=rest[0])


def has_offset(models: ErrorModel | tuple[ErrorModel, ...]) -> bool:
    """Whether the error models of a sensor, one for all axes or one per axis, have an `Offset`."""
    each = models if isinstance(models, tuple) else (models,)
    return any(isinstance(part, Offset) for model in each for part in _parts(model))


def offset_states(models: tuple[ErrorModel, ...], period_s: float) -> NDArray[np.int64]:
    """Which states of the error models of a sensor are its offsets, shape (axes,); empty where it has none."""
    places, at = [], 0
    for model in models:
        for part in _parts(model):
            if isinstance(part, Offset):
                places.append(at)
            at += part.block(period_s).size
    return np.array(places, dtype=np.int64)


def with_offsets(models: tuple[ErrorModel, ...], sds: tuple[float, ...]) -> tuple[ErrorModel, ...]:
    """Error models with an `Offset` of these standard deviations each; without any where there are none.

    Examples
    --------
    >>> from navfilter import White
    >>> str(with_offsets((White(sd=0.1),), (5.0,))[0])
    'White(sd=0.1, density=None) + Offset(density=0.0, start_sd=5.0)'
    """
    plain = tuple(_plain(model) for model in models)
    return plain if not sds else tuple(model + Offset(start_sd=sd) for model, sd in zip(plain, sds, strict=True))


def with_the_same_offsets(new: tuple[ErrorModel, ...], old: tuple[ErrorModel, ...]) -> tuple[ErrorModel, ...]:
    """New error models with the offsets that the old ones have: who learns them knows nothing of offsets."""
    offsets = [next((part for part in _parts(model) if isinstance(part, Offset)), None) for model in old]
    return tuple(
        _plain(model) if part is None else _plain(model) + part for model, part in zip(new, offsets, strict=True)
    )
