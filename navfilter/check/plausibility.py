"""What looks wrong in a vehicle although it can be read: numbers in another unit than their key says, and what cannot
work.
"""

import math
from collections.abc import Iterator
from typing import Any, NamedTuple

from navfilter.check.finding import Finding, by_severity
from navfilter.check.units_text import amount, duration, root_density
from navfilter.filter.state_layout import Layout
from navfilter.foundation.constants import ROOT_HOUR
from navfilter.learning.slow_prior import slow_prior, span_s
from navfilter.models.error_models import ErrorModel, GaussMarkov, RandomWalk, White
from navfilter.models.learned_arma import LearnedArma, learning_part
from navfilter.models.mechanisation import Mechanisation
from navfilter.models.sensors import Sensor
from navfilter.models.sensors.traits import Plausible
from navfilter.models.vehicle import Vehicle

_MANY_STATES = 120


class _Channel(NamedTuple):
    """Unit of some axes, and what is usual for them."""

    unit: str
    usual: Plausible
    axes: tuple[str, ...] = ("x", "y", "z")


def check_vehicle(vehicle: Vehicle) -> tuple[Finding, ...]:
    """What looks wrong in a vehicle, the gravest first.

    Parameters
    ----------
    vehicle : Vehicle

    Returns
    -------
    tuple of Finding
        `Finding.stream` is the place in the vehicle.toml. Severity "warning": probably a mistake; "info": worth
        knowing.

    Examples
    --------
    >>> from navfilter import Heading, Imu, Vehicle, White
    >>> found = check_vehicle(Vehicle(imu=Imu(rate_hz=100), sensors={"compass": Heading(error=White(sd=0.6))}))
    >>> found[0].stream, found[0].cure
    ('sensors.compass.error.sd', 'If 0.6 deg is meant, write sd_deg = 0.6.')
    """
    found: list[Finding] = []
    for name, drive in vehicle.imus.items() or [("", vehicle.drive)]:
        found += _drive_findings(f"imus.{name}" if name else "drive", drive)
    for name, sensor in vehicle.sensors.items():
        found += _sensor_findings(f"sensors.{name}", sensor)
    found += _whole_findings(vehicle)
    return by_severity(dict.fromkeys(found))


def _warn(place: str, text: str, cure: str) -> Finding:
    return Finding("warning", "sd", place, text, cure)


# --- drive and sensors ----------------------------------------------------------------------------------------------


def _drive_findings(place: str, drive: Mechanisation) -> Iterator[Finding]:
    yield from (_warn(f"{place}.{doubt.field}", doubt.text, doubt.cure) for doubt in drive.doubts())
    for part in drive.described():
        axes = drive.models[part.axes]
        yield from _errors(
            f"{place}.{part.place}",
            *(part.given, axes, _Channel(drive.units[part.axes][0], part.plausible), drive.period_s),
        )
        if drive.inertial and not any(model.block(drive.period_s).size for model in axes):
            cure = f'Add {{model = "random-walk", density = .., start_sd = ..}} to {part.place}, as a list.'
            text = "only white noise, no bias is estimated; every inertial unit has one."
            yield Finding("info", "bias", f"{place}.{part.place}", text, cure)
    if drive.velocity_sensor is not None:
        yield from _lever_findings("drive.velocity", drive.velocity_sensor)


def _sensor_findings(place: str, sensor: Sensor) -> Iterator[Finding]:
    if sensor.plausible is not None:
        if sensor.rate_hz > sensor.plausible.most_rate_hz:
            text = f"{sensor.rate_hz:g} Hz is unusual for this kind of sensor."
            cure = "It is in Hz, the readings per second; a held value that is repeated is no new reading."
            yield _warn(f"{place}.rate_hz", text, cure)
        channel = _Channel(sensor.unit, sensor.plausible, sensor.axis_names)
        yield from _errors(f"{place}.error", sensor.error, sensor.models, channel, 1.0 / sensor.rate_hz)
    yield from (_warn(f"{place}.{doubt.field}", doubt.text, doubt.cure) for doubt in sensor.doubts())
    if getattr(sensor, "bias_sd_rad", None) == 0.0 and any(learning_part(model) for model in sensor.models):
        text = "what it learns holds no constant bias, for readings do not show one, and none is expected."
        cure = "Say how large one may be, bias_sd_deg = 0.5, or the heading is too sure by it."
        yield Finding("info", "bias", f"{place}.bias_sd_deg", text, cure)
    yield from _lever_findings(place, sensor)
    if sensor.gate_probability < 0.95:
        share = 1.0 - sensor.gate_probability
        cure = "Usual: 0.999 or 0.9999."
        yield _warn(f"{place}.gate_probability", f"refuses {100.0 * share:.3g} % of good readings.", cure)


def _lever_findings(place: str, sensor: Sensor) -> Iterator[Finding]:
    lever = math.hypot(*getattr(sensor, "lever_arm_b_m", (0.0,)))
    if lever > 30.0:
        cure = "Lever arms are in metres, forward, right, down; for millimetres write lever_arm_b_mm."
        yield _warn(f"{place}.lever_arm_b_m", f"the sensor is {lever:.4g} m away from the reference point.", cure)


def _surface_findings(vehicle: Vehicle) -> Iterator[Finding]:
    """Fixes and a depth gauge that are both sure of the same height."""
    surface = next((n for n, s in vehicle.sensors.items() if getattr(s, "antenna_height_m", None) is not None), None)
    for name, sensor in vehicle.sensors.items():
        slow = any(model.block(1.0).size for model in sensor.models)
        if surface is None or not hasattr(sensor, "surface_height_m") or slow or getattr(sensor, "offset_sd_m", False):
            continue
        text = f"{surface} says that the antenna is above water, and {name} has no offset that this could tell."
        cure = "Set offset_sd_m, or a slow part of its error: else good fixes are refused where the two contradict."
        yield _warn(f"sensors.{name}.offset_sd_m", text, cure)


def _whole_findings(vehicle: Vehicle) -> Iterator[Finding]:
    corrected = {sensor.observes.corrects for sensor in vehicle.sensors.values()}
    size = Layout.of(vehicle).size
    if size > _MANY_STATES:
        cure = "The cost grows with the square of the states: lower orders, or one model for all axes."
        yield _warn("", f"{size} states are many.", cure)
    yield from _surface_findings(vehicle)
    if "position" not in corrected:
        text = "no position fixes: the error of the position grows without bound."
        yield Finding("info", "lacking", "sensors", text, "")
    if vehicle.drive.inertial:
        if not corrected & {"position", "velocity"}:
            cure = (
                "Add a sensor of type body-velocity or position: without one an inertial unit is lost within minutes."
            )
            yield _warn("sensors", "nothing corrects position or velocity.", cure)
        if "heading" not in corrected:
            text = "no compass: the heading is only seen through fixes while the vehicle accelerates."
            yield Finding("info", "lacking", "sensors", text, "")
        return
    for name, sensor in vehicle.sensors.items():
        if sensor.from_drive:
            text = "rest is detected from an inertial unit; dead reckoning has none."
            yield _warn(f"sensors.{name}", text, "Leave it out.")


# --- error models ---------------------------------------------------------------------------------------------------


def _errors(
    place: str, given: Any, models: tuple[ErrorModel, ...], channel: _Channel, period_s: float
) -> Iterator[Finding]:
    """Findings on one error as given: a model for all axes, or one for each."""
    several = isinstance(given, tuple)
    for k, model in enumerate(models if several else models[:1]):
        here = f"{place}.{channel.axes[k]}" if several else place
        for j, part in enumerate(model.terms):
            yield from _part_findings(f"{here}[{j}]" if len(model.terms) > 1 else here, part, channel, period_s)
        total = math.sqrt(model.block(period_s).variance)
        if total < channel.usual.least_sd:
            size = "nothing" if total == 0.0 else f"only {amount(total, channel.unit)}"
            other = f", or in another unit as sd_{channel.usual.suffix}" if channel.usual.suffix else ""
            cure = channel.usual.hint or f"A filter believes such a sensor blindly: give the sd in SI{other}."
            yield _warn(here, f"errs by {size} in all.", cure)


def _part_findings(place: str, part: ErrorModel, channel: _Channel, period_s: float) -> Iterator[Finding]:
    if isinstance(part, White) and part.density is not None:
        if part.density > channel.usual.most_density:
            size = root_density(part.density, channel.unit)
            yield _too_large(f"{place}.density", part.density, size, channel.usual.density_suffix)
        elif math.isinf(channel.usual.most_density):
            yield from _sd_findings(f"{place}.density", part.density / math.sqrt(period_s), channel)
    elif isinstance(part, White | GaussMarkov):
        yield from _sd_findings(f"{place}.sd", float(part.sd or 0.0), channel)
    elif isinstance(part, RandomWalk):
        if part.start_sd is not None:
            yield from _sd_findings(f"{place}.start_sd", part.start_sd, channel)
        if ROOT_HOUR * part.density > channel.usual.most_sd:
            cure = "The density is per second and root Hertz: (change in an hour) / 60."
            wander = amount(ROOT_HOUR * part.density, channel.unit)
            yield _warn(f"{place}.density", f"a bias that wanders by {wander} in an hour.", cure)
    elif isinstance(part, LearnedArma) and part.model is None:
        if part.window * period_s > 7200.0:
            cure = (
                f"A window of {max(int(1800.0 / period_s), 200)} readings takes half an hour or less; models of "
                "slow sensors need fewer."
            )
            text = f"{part.window} readings are {duration(part.window * period_s)} of this sensor."
            yield _warn(f"{place}.window", text, cure)
        if part.prior_within and part.prior:
            usual, known = (
                slow_prior(part.prior, period_s, span_s(part, period_s), within=within)
                for within in (None, part.prior_within)
            )
            if usual and usual == known:
                text = f"the prior has no slow error, of {duration(float(usual.taus_s[0]))} or slower, to be believed."
                yield _warn(f"{place}.prior_within", text, "Quicker ones the readings show: leave prior_within out.")
        priors = part.prior.terms if part.prior else ()
        for k, prior in enumerate(priors):
            inner = f"{place}.prior[{k}]" if len(priors) > 1 else f"{place}.prior"
            yield from _part_findings(inner, prior, channel, period_s)
    else:
        yield from _sd_findings(place, math.sqrt(part.block(period_s).variance), channel)
    if isinstance(part, GaussMarkov):
        if part.tau_s < period_s:
            text = (
                f"a correlation time of {duration(part.tau_s)} is shorter than the time between two readings, "
                f"{duration(period_s)}."
            )
            yield _warn(f"{place}.tau_s", text, "Between readings nothing is left of it: use white.")
        elif part.tau_s > 1e5:
            cure = "It is in seconds. For a bias use random-walk."
            yield _warn(f"{place}.tau_s", f"a correlation time of {duration(part.tau_s)}.", cure)


def _sd_findings(place: str, sd: float, channel: _Channel) -> Iterator[Finding]:
    if sd > channel.usual.most_sd:
        yield _too_large(place, sd, amount(sd, channel.unit), channel.usual.suffix, channel.usual.hint)


def _too_large(place: str, value: float, shown: str, suffix: str, hint: str = "") -> Finding:
    key = place.rsplit(".", 1)[-1].split("[")[0]
    if key == "density" and "sqrt" not in suffix:
        key = "sd"  # what was judged is the sd of a reading
    unit = suffix.replace("_per_sqrt_", "/sqrt(").replace("_per_", "/")
    unit = f"{unit})" if "(" in unit else unit
    cure = (
        hint or f"If {value:.3g} {unit.replace('sqrt(hz)', 'sqrt(Hz)')} is meant, write {key}_{suffix} = {value:.3g}."
    )
    if not suffix and not hint:
        cure = "Numbers are in SI."
    if key == "error":
        cure = "The sd of an ARMA model is that of its innovations, in SI: look at the poles too."
    return _warn(place, f"{shown} ({value:.3g} in SI) is far more than such a sensor errs by.", cure)
