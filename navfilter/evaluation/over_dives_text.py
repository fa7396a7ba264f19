"""What several dives have taught, in words, as plain values, and as spectra with their bands."""

from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np

from navfilter.calibration.over_dives import TOGETHER, OverDives, Weighed, known_words, models_of, posterior
from navfilter.evaluation.learned_text import Scale, density_of, error_words
from navfilter.foundation.arrays import Array
from navfilter.models.error_models import ErrorModel
from navfilter.models.scaled_errors import scaled
from navfilter.models.sensors.traits import shown_unit
from navfilter.models.spectrum import Spectrum
from navfilter.models.vehicle import Vehicle

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
