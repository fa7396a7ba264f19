"""Error models identified on a whole mission: what a replay has heard is fitted once more, all of it at a time."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from navfilter.learning.axis_learner import learner_of
from navfilter.learning.learned_model import with_learnt
from navfilter.learning.open_loop_series import ChannelSeries
from navfilter.models.error_models import ErrorModel
from navfilter.models.learned_arma import LearnedArma, learned_part, learning_part
from navfilter.models.sensors import Sensor
from navfilter.models.vehicle import Vehicle
from navfilter.models.window_limits import least_window


def learning_sensors(vehicle: Vehicle) -> list[str]:
    """Correcting sensors that learn an error model from their readings."""
    return [
        name
        for name, sensor in vehicle.sensors.items()
        if sensor.open_loop and any(learning_part(model) is not None for model in sensor.models)
    ]


def refitted(vehicle: Vehicle, series: Mapping[str, tuple[ChannelSeries, ...]]) -> Vehicle:
    """The vehicle with every learning axis fitted to a whole series and frozen there.

    The window is the whole series. An axis whose series says too little goes on learning under way.

    Parameters
    ----------
    vehicle : Vehicle
        As its operator describes it.
    series : dict of str to tuple of ChannelSeries
        See `navfilter.playback.replay.residual_series`.

    Returns
    -------
    Vehicle
    """
    found: dict[str, ErrorModel | tuple[ErrorModel, ...]] = {}
    for name, channels in series.items():
        models = _fitted(vehicle.sensors[name], channels)
        found[name] = models if len(models) > 1 else models[0]
    return vehicle.with_error(**found)


def _fitted(sensor: Sensor, channels: Sequence[ChannelSeries]) -> tuple[ErrorModel, ...]:
    fitted = []
    for model, channel in zip(sensor.models, channels, strict=True):
        part, found, size = learning_part(model), None, channel.value.size
        if part is not None and size >= least_window(sum(part.orders[0])):
            found = learner_of(part, sensor, channel.drift, channel.white, size).hop(channel.value)
        fitted.append(with_learnt(model, found, frozen=True))
    return tuple(fitted)


def change(before: Vehicle, after: Vehicle) -> float:
    """How far the models of two rounds are apart: the largest change of the logarithm of any axis's spectrum, in its
    own standard deviation.

    Parameters
    ----------
    before, after : Vehicle
        With the same sensors.

    Returns
    -------
    float
        Infinite where only one of them has a model of an axis. The median of the posterior is compared at each of its
        frequencies; a tenth of the power is not told apart.
    """
    largest = 0.0
    for name, sensor in after.sensors.items():
        pairs = zip(map(learned_part, before.sensors[name].models), map(learned_part, sensor.models), strict=True)
        largest = max([largest, *(_apart(old, new) for old, new in pairs)])
    return largest


#: What is not told apart, in the logarithm of the power.
INDISTINCT = 0.1


def _apart(old: LearnedArma | None, new: LearnedArma | None) -> float:
    one, other = (None if part is None else part.spectrum for part in (old, new))
    if one is None or other is None:
        return 0.0 if one is other else math.inf
    at = np.log(other.frequency_hz)
    before = np.interp(at, np.log(one.frequency_hz), np.log(one.median))
    # half the width of the band from 5 to 95 % is 1.64 standard deviations
    sd = np.maximum(np.log(np.divide(other.high, other.low)) / 3.29, INDISTINCT)
    return float(np.max(np.abs(np.log(other.median) - before) / sd))
