"""Rivals by name: the same vehicle with error models of one kind, fitted to the mission it is about to run.

To be fair to the older models, those that are fitted here see the whole mission beforehand, while ``arma`` learns under way from what it
has seen so far. None of them sees the truth but ``oracle``, whose very point that is.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from navfilter.arma.gauss_markov import fit_gauss_markov
from navfilter.error_models import ErrorModel, GaussMarkov, Sum, White
from navfilter.mission import Mission
from navfilter.sensors import ZeroVelocity
from navfilter.start import Start
from navfilter.vehicle import Vehicle

__all__ = ["LEAST", "MODELS", "learnable", "rival", "rivals"]

Array = NDArray[np.float64]

#: Kinds of error models that can be compared.
MODELS = ("white", "gm1", "gm1-fitted", "arma", "oracle", "vehicle")
#: An axis with fewer readings keeps the model of the vehicle file.
LEAST = 200


def rival(
    name: str,
    vehicle: Vehicle,
    mission: Mission,
    *,
    sensors: Sequence[str] | None = None,
    truth: Mapping[str, Any] | None = None,
    start: Start | None = None,
) -> Vehicle:
    """The vehicle with error models of one kind on its correcting sensors.

    Parameters
    ----------
    name : {"white", "gm1", "gm1-fitted", "arma", "oracle", "vehicle"}
        white: white noise, its sd by the likelihood of the channel (the slow navigation error estimated beside it).
        gm1: first-order Gauss-Markov through the 1/e point of the autocorrelation of the detrended series (thesis, sec. 2.3).
        gm1-fitted: first-order Gauss-Markov by that likelihood. arma: `LearnedArma`, which learns under way and begins with the model of
        the vehicle file. oracle: `truth`. vehicle: as the file says.
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


def rivals(
    names: Sequence[str],
    vehicle: Vehicle,
    mission: Mission,
    *,
    sensors: Sequence[str] | None = None,
    truth: Mapping[str, Any] | None = None,
    start: Start | None = None,
) -> dict[str, Vehicle]:
    """Several rivals at once, see `rival`; the series that they are fitted to are made only once."""
    unknown = [name for name in names if name not in MODELS]
    if unknown:
        raise ValueError(f'there is no model "{unknown[0]}". Models: {", ".join(MODELS)}.')
    chosen = learnable(vehicle, mission) if sensors is None else tuple(sensors)
    _check_sensors(vehicle, chosen)
    if "oracle" in names and not truth:
        raise ValueError('"oracle" needs the true error models (truth=, --oracle): only a simulator knows them. Leave it out.')
    series: Mapping[str, Any] = {}
    if chosen and set(names) & set(_FITS):
        from navfilter.playback import residual_series

        series = residual_series(vehicle, mission, sensors=chosen, start=start)
    return {name: vehicle.with_error(**_models(name, vehicle, chosen, series, truth or {})) for name in names}


def learnable(vehicle: Vehicle, mission: Mission) -> tuple[str, ...]:
    """Correcting sensors with enough readings to fit a model to; a detected rest is no sensor."""
    found = []
    for name, sensor in vehicle.sensors.items():
        if not isinstance(sensor, ZeroVelocity) and name in mission.streams:
            known = np.isfinite(mission.streams[name].value[:, : sensor.reads]).any(axis=1)
            if np.count_nonzero(known) >= LEAST:
                found.append(name)
    return tuple(found)


def _check_sensors(vehicle: Vehicle, names: Sequence[str]) -> None:
    for name in names:
        if name not in vehicle.sensors or isinstance(vehicle.sensors[name], ZeroVelocity):
            have = ", ".join(key for key, sensor in vehicle.sensors.items() if not isinstance(sensor, ZeroVelocity)) or "none"
            raise ValueError(f'"{name}" is no correcting sensor of this vehicle (sensors: {have}).')


def _models(
    kind: str, vehicle: Vehicle, names: Sequence[str], series: Mapping[str, Any], truth: Mapping[str, Any]
) -> dict[str, ErrorModel | tuple[ErrorModel, ...]]:
    if kind == "vehicle":
        return {}
    if kind == "oracle":
        return {name: model for name, model in truth.items() if name in vehicle.sensors}
    found: dict[str, ErrorModel | tuple[ErrorModel, ...]] = {}
    for name in names:
        priors = vehicle.sensors[name].models
        if kind == "arma":
            models = tuple(_learning(prior) for prior in priors)
        else:
            models = tuple(_fitted(kind, channel, prior) for channel, prior in zip(series[name], priors, strict=True))
        found[name] = models[0] if len(models) == 1 else models
    return found


def _learning(prior: ErrorModel) -> ErrorModel:
    """The axis learns, from its model in the vehicle file on; one that learns already is left as it is."""
    from navfilter.learned import LearnedArma

    parts = prior.parts if isinstance(prior, Sum) else (prior,)
    return prior if any(isinstance(part, LearnedArma) for part in parts) else LearnedArma(prior=prior)


# --- fits -------------------------------------------------------------------------------------------------------------


def _fitted(kind: str, channel: Any, prior: ErrorModel) -> ErrorModel:
    """The model of one axis; that of the vehicle file where there are too few readings, or they never change."""
    known = channel.value[np.isfinite(channel.value)]
    if known.size < LEAST or np.ptp(known) == 0.0:
        return prior
    return _FITS[kind](channel)


def _white(channel: Any) -> ErrorModel:
    from navfilter.learning.channel import fit_channel

    return White(sd=float(fit_channel(channel.value, channel.drift, 0, 0).model.sd))


def _gm1_fitted(channel: Any) -> ErrorModel:
    """Order (1, 0) of the channel: ``x[t] = phi x[t-1] + e`` is the sampled Gauss-Markov process with ``phi = exp(-period/tau)``."""
    from navfilter.learning.channel import fit_channel

    model = fit_channel(channel.value, channel.drift, 1, 0).model
    phi = -float(model.ar[0])
    if phi <= 0.0:
        # No such process alternates; the best one is that whose time constant goes to zero.
        return _white(channel)
    phi = min(phi, 1.0 - 1e-9)
    return GaussMarkov(sd=float(model.sd) / math.sqrt(1.0 - phi * phi), tau_s=-channel.period_s / math.log(phi))


def _gm1(channel: Any) -> ErrorModel:
    """The thesis's way: autocorrelation of the longest stretch without a long gap, detrended, and where it falls to 1/e.

    The detrending polynomial has the degree that the slow navigation error would have without noise: it is a chain of integrators.
    """
    value = _longest_stretch(channel.value)
    at = np.linspace(-1.0, 1.0, value.size)
    known = np.isfinite(value)
    trend = np.polynomial.Polynomial.fit(at[known], value[known], len(channel.drift.density) - 1)
    series = np.where(known, value - trend(at), np.nan)
    fit = fit_gauss_markov(series, 1, 1.0 / channel.period_s, method="1/e")
    return GaussMarkov(sd=fit.sd, tau_s=fit.tau_s)


def _longest_stretch(value: Array, longest_gap: int = 40) -> Array:
    """The stretch with most readings between gaps of more than so many missing ones."""
    known = np.flatnonzero(np.isfinite(value))
    cuts = np.flatnonzero(np.diff(known) > longest_gap) + 1
    best = max(np.split(known, cuts), key=len)
    return value[best[0] : best[-1] + 1]


_FITS = {"white": _white, "gm1": _gm1, "gm1-fitted": _gm1_fitted}
