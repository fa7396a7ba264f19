"""Rivals by name: the same vehicle with error models of one kind, fitted to the mission it is about to run.

To be fair to the older models, those that are fitted here see the whole mission beforehand, while ``arma`` learns under
way from what it has seen so far. None of them sees the truth but ``oracle``, whose very point that is.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from navfilter.evaluation.adaptive import RULES, adaptive_monitor, as_white
from navfilter.foundation.arrays import Array
from navfilter.learning.open_loop_series import ChannelSeries
from navfilter.models.error_models import ErrorModel, Errors, GaussMarkov, RandomWalk, White, sum_of
from navfilter.models.learned_arma import LearnedArma, known_white, learned_part
from navfilter.models.mission import Mission
from navfilter.models.start import Start
from navfilter.models.vehicle import Vehicle
from navfilter.models.window_limits import LEAST
from navfilter.playback.replay import replay, replay_monitored, residual_series
from navfilter.timeseries.gauss_markov import fit_gauss_markov
from navfilter.track.track import Track

__all__ = ["LEAST"]

Series = Mapping[str, tuple[ChannelSeries, ...]]

#: Kinds of error models that can be compared.
MODELS = ("white", "gm1", "gm1-fitted", "arma", "oracle", "vehicle", *RULES)


def rival(
    name: str,
    vehicle: Vehicle,
    mission: Mission,
    *,
    sensors: Sequence[str] | None = None,
    truth: Mapping[str, Errors] | None = None,
    start: Start | None = None,
) -> Vehicle:
    """The vehicle with error models of one kind on its correcting sensors.

    Parameters
    ----------
    name : str
        One of `MODELS`.
        white: white noise, its sd by the likelihood of the channel (the slow navigation error estimated beside it).
        gm1: first-order Gauss-Markov through the 1/e point of the autocorrelation of the detrended series (thesis, sec.
        2.3). gm1-fitted: first-order Gauss-Markov by that likelihood. arma: `LearnedArma`, which learns under way and
        begins with the model of the vehicle file. oracle: `truth`. vehicle: as the file says. iae, sage-husa, vb, imm,
        student-t: white noise of the variance that the file describes; `replay_rival` adapts it
        (`navfilter.evaluation.adaptive`).
    vehicle : Vehicle
        As its operator describes it.
    mission : Mission
    sensors : sequence of str, optional
        Which ones; default all of `learnable`.
    truth : dict of str to ErrorModel or tuple of ErrorModel, optional
        The simulator's models by sensor; only for "oracle". A sensor that is not in it keeps its model.
    start : Start, optional
        As for `navfilter.replay`.

    Returns
    -------
    Vehicle

    Raises
    ------
    ValueError
        For an unknown name or sensor, and for "oracle" without a truth.
    """
    return rivals((name,), vehicle, mission, sensors=sensors, truth=truth, start=start)[name]


def replay_rival(
    name: str, vehicle: Vehicle, mission: Mission, sensors: Sequence[str] | None = None, **how: Any
) -> Track:
    """Replay a rival, see `rival`; those that adapt their noise do so.

    Parameters
    ----------
    name : str
    vehicle : Vehicle
        As `rival` gave it.
    mission : Mission
    sensors : sequence of str, optional
        Which ones adapt; default all.
    **how
        Of `navfilter.replay`.
    """
    if name not in RULES:
        return replay(vehicle, mission, **how)
    return replay_monitored(vehicle, mission, adaptive_monitor(vehicle, RULES[name], sensors), **how)


def rivals(
    names: Sequence[str],
    vehicle: Vehicle,
    mission: Mission,
    *,
    sensors: Sequence[str] | None = None,
    truth: Mapping[str, Errors] | None = None,
    start: Start | None = None,
    series: Series | None = None,
) -> dict[str, Vehicle]:
    """Several rivals at once, see `rival`; the series that they are fitted to are made only once, or not at all where
    they are given (see `navfilter.playback.replay.replay_heard`).
    """
    unknown = [name for name in names if name not in MODELS]
    if unknown:
        raise ValueError(f'there is no model "{unknown[0]}". Models: {", ".join(MODELS)}.')
    sensors = [sensors] if isinstance(sensors, str) else sensors
    chosen = learnable(vehicle, mission) if sensors is None else tuple(sensors)
    _check_sensors(vehicle, chosen)
    if "oracle" in names and not truth:
        raise ValueError(
            '"oracle" needs the true error models (truth=, --oracle): only a simulator knows them. Leave it out.'
        )
    if series is None:
        series = residual_series(vehicle, mission, chosen, start) if chosen and fitted_kinds(names) else {}
    return {name: vehicle.with_error(**_models(name, vehicle, chosen, series, truth or {})) for name in names}


def fitted_kinds(names: Sequence[str]) -> tuple[str, ...]:
    """Those of the models that are fitted to a whole mission beforehand."""
    return tuple(name for name in names if name in _FITS)


def learnable(vehicle: Vehicle, mission: Mission) -> tuple[str, ...]:
    """Correcting sensors with readings of their own, and enough of them to fit a model to."""
    found = []
    for name, sensor in vehicle.sensors.items():
        if sensor.open_loop and name in mission.streams:
            known = np.isfinite(mission.streams[name].value[:, : sensor.reads]).any(axis=1)
            if np.count_nonzero(known) >= LEAST:
                found.append(name)
    return tuple(found)


def _check_sensors(vehicle: Vehicle, names: Sequence[str]) -> None:
    for name in names:
        if name not in vehicle.sensors or not vehicle.sensors[name].open_loop:
            have = ", ".join(key for key, sensor in vehicle.sensors.items() if sensor.open_loop) or "none"
            raise ValueError(
                f'"{name}" is no sensor of this vehicle whose error could be modelled from its readings (there are: '
                f"{have})."
            )


def _models(
    kind: str, vehicle: Vehicle, names: Sequence[str], series: Series, truth: Mapping[str, Errors]
) -> dict[str, Errors]:
    if kind == "vehicle":
        return {}
    if kind == "oracle":
        return {name: model for name, model in truth.items() if name in vehicle.sensors}
    found: dict[str, Errors] = {}
    for name in names:
        priors = vehicle.sensors[name].models
        if kind == "arma":
            models = tuple(_learning(prior) for prior in priors)
        elif kind in RULES:
            models = tuple(as_white(prior, 1.0 / vehicle.sensors[name].rate_hz) for prior in priors)
        else:
            models = tuple(_fitted(kind, channel, prior) for channel, prior in zip(series[name], priors, strict=True))
        found[name] = models[0] if len(models) == 1 else models
    return found


def _split(model: ErrorModel) -> tuple[list[ErrorModel], list[ErrorModel]]:
    """Random walks, which are the bias of a sensor and stay as they are in every rival, and the rest."""
    walks: list[ErrorModel] = [part for part in model.terms if isinstance(part, RandomWalk)]
    return walks, [part for part in model.terms if not isinstance(part, RandomWalk)]


def _learning(prior: ErrorModel) -> ErrorModel:
    """The axis learns, from its model in the vehicle file on; one that learns already is left as it is."""
    if learned_part(prior) is not None:
        return prior
    walks, rest = _split(prior)
    return sum_of([*walks, LearnedArma(prior=sum_of(rest) if rest else None)])


# --- fits -----------------------------------------------------------------------------------------------------------


def _fitted(kind: str, channel: ChannelSeries, prior: ErrorModel) -> ErrorModel:
    """The model of one axis; that of the vehicle file where there are too few readings, or they never change."""
    known = channel.value[np.isfinite(channel.value)]
    if known.size < LEAST or np.ptp(known) == 0.0:
        return prior
    # White noise that stands beside a learnt part is the sensor's and to be fitted; what is known to be white beyond it
    # is not.
    white = max(channel.white - known_white(prior, channel.period_s), 0.0)
    return sum_of([*_split(prior)[0], _FITS[kind](channel, white)])


def _white(channel: ChannelSeries, white: float) -> ErrorModel:
    from navfilter.learning.arma_fit import fit_channel

    return White(sd=float(fit_channel(channel.value, channel.drift, 0, 0, white=white).model.sd))


def _gm1_fitted(channel: ChannelSeries, white: float) -> ErrorModel:
    """Order (1, 0) of the channel: ``x[t] = phi x[t-1] + e`` is the sampled Gauss-Markov process with ``phi =
    exp(-period/tau)``.
    """
    from navfilter.learning.arma_fit import fit_channel

    model = fit_channel(channel.value, channel.drift, 1, 0, white=white).model
    phi = -float(model.ar[0])
    if phi <= 0.0:
        # No such process alternates; the best one is that whose time constant goes to zero.
        return _white(channel, white)
    phi = min(phi, 1.0 - 1e-9)
    return GaussMarkov(sd=float(model.sd) / math.sqrt(1.0 - phi * phi), tau_s=-channel.period_s / math.log(phi))


def _gm1(channel: ChannelSeries, white: float) -> ErrorModel:
    """The thesis's way: autocorrelation of the detrended series, and where it falls to 1/e.

    The detrending polynomial has the degree that the slow navigation error would have without noise: it is a chain of
    integrators.
    """
    value = _longest_stretch(channel.value)
    at = np.linspace(-1.0, 1.0, value.size)
    known = np.isfinite(value)
    trend = np.polynomial.Polynomial.fit(at[known], value[known], max(channel.drift.order - 1, 0))
    fit = fit_gauss_markov(np.where(known, value - trend(at), np.nan), 1, 1.0 / channel.period_s, method="1/e")
    return GaussMarkov(sd=fit.sd, tau_s=fit.tau_s)


def _longest_stretch(value: Array, gap: int = 40, least: int = 50) -> Array:
    """The stretch with most readings between gaps of more than `gap` missing ones; all of it where that leaves too
    little.
    """
    known = np.flatnonzero(np.isfinite(value))
    best = max(np.split(known, np.flatnonzero(np.diff(known) > gap) + 1), key=len)
    return value if best.size < least else value[best[0] : best[-1] + 1]


_FITS: dict[str, Callable[[ChannelSeries, float], ErrorModel]] = {
    "white": _white,
    "gm1": _gm1,
    "gm1-fitted": _gm1_fitted,
}
