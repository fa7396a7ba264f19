"""What was learnt, in words: the error models in force at the end of a run beside those that vehicle.toml believed."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from navfilter.arma.model import ArmaModel
from navfilter.error_models import Arma, ErrorModel, GaussMarkov, RandomWalk, Sum, White
from navfilter.identification.reading import Component, number, stationary_parts
from navfilter.learning.learned import LearnedArma, learned_part
from navfilter.sensors.traits import shown_unit
from navfilter.track import Track

__all__ = ["Learnt", "error_words", "learnt", "model_words"]

Array = NDArray[np.float64]

#: Samples behind a model that does not say so.
WINDOW = 4000
#: Of a pair of poles nearer to the negative axis than this the period means nothing: about two samples.
SHORTEST_PERIOD = 2.5


class Scale(NamedTuple):
    """How values of an axis are shown, and how often it is sampled."""

    unit: str
    factor: float
    rate_hz: float


@dataclass(frozen=True)
class Learnt:
    """What one axis of a sensor has learnt.

    Attributes
    ----------
    title : str
        Sensor and axis, "compass", "dvl x".
    scale : Scale
        Unit, factor from SI, and rate [Hz].
    believed : ErrorModel
        Of the whole axis before anything was learnt.
    beside : tuple of ErrorModel
        What stands beside the learnt part and stays.
    time_s : tuple of float
        From when each model was in force [s].
    models : tuple of ArmaModel
        Those of the learnt part.
    """

    title: str
    scale: Scale
    believed: ErrorModel
    beside: tuple[ErrorModel, ...]
    time_s: tuple[float, ...]
    models: tuple[ArmaModel, ...]

    @property
    def words(self) -> str:
        """The model in force at the end."""
        parts = [model_words(self.models[-1], self.scale), *(error_words(part, self.scale) for part in self.beside)]
        return ", ".join(parts)

    def __str__(self) -> str:
        return f"{self.title}: {self.words}; vehicle.toml believed {error_words(self.believed, self.scale)}"

    def to_dict(self) -> dict[str, Any]:
        """The same as plain values."""
        return {
            "unit": self.scale.unit,
            "words": self.words,
            "believed": error_words(self.believed, self.scale),
            "history": [[t, model_words(model, self.scale)] for t, model in zip(self.time_s, self.models, strict=True)],
        }

    def spectrum(self, freq_hz: Array) -> tuple[Array, Array]:
        """Density of the learnt part [unit^2/Hz, as shown] and the sd of its logarithm, shape (n,) each.

        Notes
        -----
        To first order ``ln S = 2 ln sd + 2 ln |C| - 2 ln |A|`` varies with the coefficients by ``2 Re(z^-k / C)`` and
        ``-2 Re(z^-k / A)``, and with the variance by ``2 / n`` (at zero frequency: `log_s0_sd`).
        """
        model = self.models[-1]
        density = self.scale.factor**2 * model.spectrum(freq_hz, self.scale.rate_hz)
        variance = np.full(len(freq_hz), 2.0 / (model.effective_window or WINDOW))
        if model.covariance is not None and model.p + model.q:
            z = np.exp(-2j * np.pi * freq_hz / self.scale.rate_hz)
            by = [
                sign * 2.0 * z**k / np.polynomial.polynomial.polyval(z, np.r_[1.0, coefficients])
                for sign, coefficients in ((-1.0, model.ar), (1.0, model.ma))
                for k in range(1, len(coefficients) + 1)
            ]
            gradient = np.real(np.array(by))
            variance += np.einsum("in,ij,jn->n", gradient, model.covariance, gradient)
        return density, np.sqrt(np.maximum(variance, 0.0))

    def believed_spectrum(self, freq_hz: Array) -> Array:
        """Density of what was believed [unit^2/Hz, as shown], shape (n,)."""
        return self.scale.factor**2 * _density(self.believed, freq_hz, self.scale.rate_hz)


def learnt(track: Track) -> tuple[Learnt, ...]:
    """What every axis of a run has learnt; axes that have learnt nothing are left out.

    Parameters
    ----------
    track : Track
    """
    found = []
    for name, history in track.error_models.items():
        for i, (axis, believed, unit, rate_hz) in enumerate(_axes(track, name)):
            steps: list[tuple[float, ArmaModel]] = []
            beside: tuple[ErrorModel, ...] = ()
            for time_s, error in history:
                model = error[i] if isinstance(error, tuple) else error
                part = learned_part(model)
                # what has not changed is the adoption of another axis
                if part is not None and part.model is not None and (not steps or steps[-1][1] != part.model):
                    steps.append((float(time_s), part.model))
                    beside = tuple(p for p in _parts(model) if p is not part)
            if steps:
                times, models = zip(*steps, strict=True)
                scale = Scale(*shown_unit(unit), rate_hz)
                found.append(Learnt(f"{name} {axis}".strip(), scale, _before(believed), beside, times, models))
    return tuple(found)


def _axes(track: Track, name: str) -> Iterator[tuple[str, ErrorModel, str, float]]:
    """Name, model, unit and rate of every axis of a sensor, or of a part of the drive ("gyro")."""
    sensor, drive = track.vehicle.sensors.get(name), track.vehicle.drive
    if sensor is not None:
        for axis, model, unit in zip(sensor.axis_names, sensor.models, sensor.units, strict=True):
            yield axis, model, unit, sensor.rate_hz
        return
    for axis, model, unit in zip(drive.axis_names, drive.models, drive.units, strict=True):
        owner, _, short = axis.rpartition("_")
        if owner == name:
            yield short, model, unit, 1.0 / drive.period_s


def _before(model: ErrorModel) -> ErrorModel:
    """A model with the prior in place of what is learnt."""
    parts: list[ErrorModel] = []
    for part in _parts(model):
        if isinstance(part, LearnedArma):
            part = part.prior or LearnedArma(model=part.model)
        parts += _parts(part)
    return Sum(tuple(parts)) if len(parts) > 1 else parts[0]


def _parts(model: ErrorModel) -> tuple[ErrorModel, ...]:
    return model.parts if isinstance(model, Sum) else (model,)


# --- words ----------------------------------------------------------------------------------------------------------


def error_words(model: ErrorModel, scale: Scale) -> str:
    """An error model in words, with its sizes in the unit that is shown; a kind not known here as it prints itself.

    Parameters
    ----------
    model : ErrorModel
    scale : Scale

    Examples
    --------
    >>> error_words(GaussMarkov(sd=0.01, tau_s=30.0) + White(sd=0.005), Scale("deg", 180 / math.pi, 8.0))
    'slow error 0.57 deg over 30 s, white 0.29 deg'
    """
    return ", ".join(_part_words(part, scale) for part in _parts(model))


def _part_words(part: ErrorModel, scale: Scale) -> str:
    if isinstance(part, White):
        return _words(Component("white", math.sqrt(part.block(1.0 / scale.rate_hz).r)), scale)
    if isinstance(part, GaussMarkov):
        return _words(Component("gauss-markov", part.sd, part.tau_s), scale)
    if isinstance(part, RandomWalk):
        return _words(Component("random walk", part.density / math.sqrt(scale.rate_hz)), scale)
    if isinstance(part, Arma):
        return model_words(ArmaModel(np.array(part.ar), np.array(part.ma), part.sd), scale)
    if isinstance(part, LearnedArma) and part.model is not None:
        return model_words(part.model, scale)
    return str(part)


def model_words(model: ArmaModel, scale: Scale) -> str:
    """A stationary ARMA model in words: its parts, the slowest first, with the standard deviation of each.

    Parameters
    ----------
    model : ArmaModel
    scale : Scale
    """
    parts = stationary_parts(model, scale.rate_hz)
    if not all(math.isfinite(part.sd) for part in parts):
        parts = _by_bands(model, parts, scale.rate_hz)
    return ", ".join(_words(part, scale) for part in parts)


def _by_bands(model: ArmaModel, parts: list[Component], rate_hz: float) -> list[Component]:
    """The parts of a model that is no sum of independent ones, with the power of the frequencies nearest to each."""
    nyquist = 0.5 * rate_hz
    own = [p.freq_hz if p.freq_hz > 0.0 else 1.0 / (2.0 * math.pi * p.tau_s) for p in parts]
    edges = np.geomspace(1e-4 * min(min(own), nyquist), nyquist, 4000)
    power = model.spectrum(0.5 * (edges[1:] + edges[:-1]), rate_hz) * np.diff(edges)
    nearest = np.argmin(np.abs(np.log(edges[1:, None]) - np.log(np.minimum(own, nyquist))), axis=1)
    return [replace(p, sd=math.sqrt(float(power[nearest == i].sum()))) for i, p in enumerate(parts)]


def _words(part: Component, scale: Scale) -> str:
    """One part: what it is, how large, how long."""
    size = f" {_size(part.sd, scale)}" if math.isfinite(part.sd) else ""
    if part.kind in ("random walk", "correlated walk"):
        an_hour = f" by {_size(60.0 * part.sd * math.sqrt(scale.rate_hz), scale)} in an hour" if size else ""
        return f"wanders{an_hour}" if part.sd else "a constant"
    if part.kind in ("line", "oscillation") and part.freq_hz > 0.0:
        period_s = 1.0 / part.freq_hz
        if period_s * scale.rate_hz < SHORTEST_PERIOD:
            return f"alternates from reading to reading{f' by{size}' if size else ''}"
        return f"swings with {_seconds(period_s)}{f' by{size}' if size else ''}"
    if part.kind in ("gauss-markov", "second order"):
        return f"slow error{size} over {_seconds(part.tau_s)}"
    if part.kind == "short":
        return f"short error{size} over {_seconds(part.tau_s)}"
    return f"{'white' if part.kind == 'white' else 'short error'}{size}"


def _size(sd: float, scale: Scale) -> str:
    return f"{number(scale.factor * sd, 2)} {scale.unit}"


def _seconds(value: float) -> str:
    return f"{value:.0f} s" if value >= 10.0 else f"{number(value, 2)} s"


def _density(model: ErrorModel, freq_hz: Array, rate_hz: float) -> Array:
    """One-sided density of any error model through its block [unit^2/Hz], shape (n,)."""
    block = model.block(1.0 / rate_hz)
    density = np.full(len(freq_hz), block.r)
    if block.size:
        z = np.exp(2j * np.pi * freq_hz / rate_hz)[:, None, None]
        C = np.broadcast_to(block.C.astype(complex), (len(freq_hz), block.size))
        response = np.linalg.solve(np.swapaxes(z * np.eye(block.size) - block.Phi, 1, 2), C[:, :, None])[:, :, 0]
        density = density + np.real(np.einsum("ni,ij,nj->n", response, block.Q, response.conj()))
    return 2.0 / rate_hz * density
