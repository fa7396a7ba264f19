"""What several dives have taught, in words, as plain values, and as spectra with their bands.

What was learnt, in words: the error models in force at the end of a run beside those that vehicle.toml believed.
"""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from navfilter.calibration.over_dives import TOGETHER, OverDives, Weighed, known_words, models_of, posterior
from navfilter.foundation.arrays import Array
from navfilter.models.error_models import Arma, Cycle, ErrorModel, GaussMarkov, RandomWalk, White, sum_of
from navfilter.models.interpretation import Component, number, seconds_text, stationary_parts
from navfilter.models.learned_arma import LearnedArma, learned_part, scaled
from navfilter.models.sensors.traits import shown_unit
from navfilter.models.spectrum import Spectrum
from navfilter.models.vehicle import Vehicle
from navfilter.timeseries.model import ArmaModel
from navfilter.track.track import Track

#: Of a pair of poles nearer to the negative axis than this the period means nothing: about two samples.
SHORTEST_PERIOD = 2.5


class Scale(NamedTuple):
    """How values of an axis are shown, and how often it is sampled."""

    unit: str
    factor: float
    rate_hz: float


@dataclass(frozen=True)
class LearnedText:
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
    adopted : tuple of LearnedArma
        Those of the learnt part, each with its model.
    """

    title: str
    scale: Scale
    believed: ErrorModel
    beside: tuple[ErrorModel, ...]
    time_s: tuple[float, ...]
    adopted: tuple[LearnedArma, ...]

    @property
    def models(self) -> tuple[ArmaModel, ...]:
        """Their fast parts."""
        return tuple(part.model for part in self.adopted if part.model is not None)

    @property
    def words(self) -> str:
        """The model in force at the end."""
        return ", ".join(error_words(part, self.scale) for part in (self.adopted[-1], *self.beside))

    def __str__(self) -> str:
        return f"{self.title}: {self.words}; vehicle.toml believed {error_words(self.believed, self.scale)}"

    def to_dict(self) -> dict[str, Any]:
        """The same as plain values."""
        return {
            "unit": self.scale.unit,
            "words": self.words,
            "believed": error_words(self.believed, self.scale),
            "history": [[t, error_words(part, self.scale)] for t, part in zip(self.time_s, self.adopted, strict=True)],
        }

    @property
    def spectrum(self) -> tuple[Array, Array, Array, Array]:
        """Frequencies [Hz], and the density of the learnt part that its posterior is below with a probability of 5, 50
        and 95 % [unit^2/Hz, as shown]; shape (n,) each. Empty for a model that was not learnt in this run.
        """
        spectrum = self.adopted[-1].spectrum
        if spectrum is None:
            return np.zeros(0), np.zeros(0), np.zeros(0), np.zeros(0)
        square = self.scale.factor**2
        low, median, high = (square * np.array(each) for each in (spectrum.low, spectrum.median, spectrum.high))
        return np.array(spectrum.frequency_hz), low, median, high

    def believed_spectrum(self, freq_hz: Array) -> Array:
        """Density of what was believed [unit^2/Hz, as shown], shape (n,)."""
        return self.scale.factor**2 * density_of(self.believed, freq_hz, self.scale.rate_hz)


def learnt(track: Track) -> tuple[LearnedText, ...]:
    """What every axis of a run has learnt; axes that have learnt nothing are left out.

    Parameters
    ----------
    track : Track
    """
    found = []
    for name, history in track.error_models.items():
        for i, (axis, believed, unit, rate_hz) in enumerate(_learnt_axes(track, name)):
            steps: list[tuple[float, LearnedArma]] = []
            beside: tuple[ErrorModel, ...] = ()
            for time_s, error in history:
                model = error[i] if isinstance(error, tuple) else error
                part = learned_part(model)
                # what has not changed is the adoption of another axis
                if part is not None and part.model is not None and (not steps or steps[-1][1] != part):
                    steps.append((float(time_s), part))
                    beside = tuple(p for p in model.terms if p is not part)
            if steps:
                times, parts = zip(*steps, strict=True)
                scale = Scale(*shown_unit(unit), rate_hz)
                found.append(LearnedText(f"{name} {axis}".strip(), scale, _before(believed), beside, times, parts))
    return tuple(found)


def _learnt_axes(track: Track, name: str) -> Iterator[tuple[str, ErrorModel, str, float]]:
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
    for part in model.terms:
        if isinstance(part, LearnedArma):
            part = part.prior or LearnedArma(model=part.model)
        parts += part.terms
    return sum_of(parts)


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
    return ", ".join(_part_words(part, scale) for part in model.terms)


def _part_words(part: ErrorModel, scale: Scale) -> str:
    if isinstance(part, White):
        return _words(Component("white", math.sqrt(part.block(1.0 / scale.rate_hz).r)), scale)
    if isinstance(part, GaussMarkov):
        return _words(Component("gauss-markov", part.sd, part.tau_s), scale)
    if isinstance(part, Cycle):
        return f"{_words(Component('swing', part.sd), scale)} of {part.period_s:.3g} s"
    if isinstance(part, RandomWalk):
        return _words(Component("random walk", part.density / math.sqrt(scale.rate_hz)), scale)
    if isinstance(part, Arma):
        return model_words(ArmaModel(np.array(part.ar), np.array(part.ma), part.sd), scale)
    if isinstance(part, LearnedArma) and part.model is not None:
        return ", ".join([*(_part_words(one, scale) for one in part.beside), model_words(part.model, scale)])
    if isinstance(part, LearnedArma):
        return f"to be learnt{'' if part.prior is None else f', until then {error_words(part.prior, scale)}'}"
    return str(part)


def in_force(track: Track, name: str, error: ErrorModel | tuple[ErrorModel, ...]) -> str:
    """The error models of all axes of a sensor, or of a part of the drive, in words; axes with the same words together.

    Parameters
    ----------
    track : Track
    name : str
        As in `Track.error_models`.
    error : ErrorModel or tuple of ErrorModel
        One for all axes, or one for each.
    """
    models = error if isinstance(error, tuple) else (error,)
    axes = list(_learnt_axes(track, name))
    if len(models) not in (1, len(axes)) or not axes:
        return "; ".join(map(str, models))
    together: dict[str, list[str]] = {}
    for model, (axis, _, unit, rate_hz) in zip(models, axes, strict=False):
        together.setdefault(error_words(model, Scale(*shown_unit(unit), rate_hz)), []).append(axis)
    if len(together) == 1:
        return next(iter(together))
    return "; ".join(f"{', '.join(which)}: {words}" for words, which in together.items())


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
        return f"swings with {seconds_text(period_s)}{f' by{size}' if size else ''}"
    if part.kind in ("gauss-markov", "second order"):
        return f"slow error{size} over {seconds_text(part.tau_s)}"
    if part.kind == "short":
        return f"short error{size} over {seconds_text(part.tau_s)}"
    return f"{'white' if part.kind == 'white' else 'short error'}{size}"


def _size(sd: float, scale: Scale) -> str:
    return f"{number(scale.factor * sd, 2)} {scale.unit}"


def density_of(model: ErrorModel, freq_hz: Array, rate_hz: float) -> Array:
    """One-sided density of any error model through its block [unit^2/Hz], shape (n,)."""
    block = model.block(1.0 / rate_hz)
    density = np.full(len(freq_hz), block.r)
    if block.size:
        z = np.exp(2j * np.pi * freq_hz / rate_hz)[:, None, None]
        C = np.broadcast_to(block.C.astype(complex), (len(freq_hz), block.size))
        response = np.linalg.solve(np.swapaxes(z * np.eye(block.size) - block.Phi, 1, 2), C[:, :, None])[:, :, 0]
        density = density + np.real(np.einsum("ni,ij,nj->n", response, block.Q, response.conj()))
    return 2.0 / rate_hz * density


#: From one period in so many samples up to half the rate, at so many frequencies.
LONGEST, FREQUENCIES = 2000, 60


class AxisSpectra(NamedTuple):
    """Spectra of one axis, in the unit that is shown.

    Attributes
    ----------
    title, unit : str
    freq_hz : ndarray, shape (n,)
    described, learnt : ndarray, shape (n,)
        One-sided densities as described, and as handed out [unit^2/Hz].
    low, high : ndarray, shape (n,)
        The posterior is below them with a probability of 5 and 95 %.
    dives : tuple of ndarray, shape (n,)
        The mean by each dive of this run alone.
    """

    title: str
    unit: str
    freq_hz: Array
    described: Array
    learnt: Array
    low: Array
    high: Array
    dives: tuple[Array, ...]


def learnt_lines(result: OverDives) -> Iterator[str]:
    """What the terminal shows at the end."""
    for name, known in result.known.items():
        yield f"{name}: {known_words(known)}"
        for title, scale, before, after in _axes(result, name):
            yield f"  {title}: {error_words(after, scale)}; described: {error_words(before, scale)}"
    count = len(result.counted)
    much = "likelier" if result.gain >= 0.0 else "less likely"
    yield (
        f"By what is learnt the fixes after the gaps of {count} dive{'s' * (count > 1)} are "
        f"{abs(result.gain):.1f} nats {much} than as described."
    )
    if not result.tells:
        yield "They tell nothing of these sensors: gaps are too short, or something else errs more."


def to_dict(result: OverDives) -> dict[str, Any]:
    """The same as plain values."""
    return {
        "sensors": {name: one._asdict() for name, one in result.known.items()},
        "gain_nats": result.gain,
        "tells": result.tells,
        "counted": [list(pair) for pair in result.counted],
        "dives": [
            {key: getattr(dive, key) for key in ("name", "gaps", "longest_s", "missed_m", "believed_m", "nees")}
            for dive in result.dives
        ],
    }


def axis_spectra(result: OverDives, name: str) -> Iterator[AxisSpectra]:
    """Spectra of all axes of a sensor that are described differently."""
    weights = posterior(result.evidence)
    each = [posterior(dive.evidence) for dive in result.dives]
    _, period_s = models_of(result.described, name)
    for title, scale, before, after in _axes(result, name):
        freq_hz = np.geomspace(scale.rate_hz / LONGEST, 0.5 * scale.rate_hz, FREQUENCIES)
        square = scale.factor**2
        described, learnt = (square * density_of(model, freq_hz, scale.rate_hz) for model in (before, after))
        parts = [square * density_of(scaled(before, period_s, *f), freq_hz, scale.rate_hz) for f in _ONE_BY_ONE]
        density, weight = _candidates(weights, name, parts, described)
        band = Spectrum.weighted(freq_hz, density, weight)
        alone = [_candidates(of, name, parts, described) for of in each]
        means = tuple(weight @ density for density, weight in alone)
        low, high = np.array(band.low), np.array(band.high)
        yield AxisSpectra(title, scale.unit, freq_hz, described, learnt, low, high, means)


#: The quick part alone, and the slow one.
_ONE_BY_ONE = ((1.0, 0.0), (0.0, 1.0))


def _candidates(weights: Mapping[str, Weighed], name: str, parts: list[Array], described: Array) -> tuple[Array, Array]:
    """Densities of all candidates, shape (m, n), and their weights; those about other sensors leave it as described."""
    own = [weights[of] for of in (name, TOGETHER) if of in weights]
    densities, mass = [described], [max(1.0 - sum(float(one.weight.sum()) for one in own), 0.0)]
    for one in own:
        for (i, j), weight in np.ndenumerate(one.weight):
            densities.append(one.quick[i] ** 2 * parts[0] + one.slow[j] ** 2 * parts[1])
            mass.append(float(weight))
    return np.array(densities), np.array(mass)


def _axes(result: OverDives, name: str) -> Iterator[tuple[str, Scale, ErrorModel, ErrorModel]]:
    """Title, scale, and error before and after, of all axes that are described differently."""
    before, period_s = models_of(result.described, name)
    after, _ = models_of(result.vehicle, name)
    units, axes = _shown(result.described, name, len(before))
    alike = len(set(before)) == 1
    for k, (model, learnt) in enumerate(zip(before, after, strict=True)):
        if k and alike:
            return
        unit, factor = shown_unit(units[k])
        title = name if alike or not axes[k] else f"{name} {axes[k]}"
        yield title, Scale(unit, factor, 1.0 / period_s), model, learnt


def _shown(vehicle: Vehicle, name: str, count: int) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Units and names of the axes of a sensor, or of a part of the drive."""
    part = vehicle.sensors.get(name) or getattr(vehicle.drive, name)
    if hasattr(part, "units"):
        return part.units, part.axis_names
    unit = {"gyro": "rad_per_s", "accel": "m_s2", "attitude": "rad"}.get(name, "m_s")
    axes = ("roll", "pitch", "yaw") if name == "attitude" else ("x", "y", "z")
    return (unit,) * count, axes
