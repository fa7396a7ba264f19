"""What looks wrong in a vehicle although it can be read: numbers in another unit than their key says, and what cannot work."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from navfilter.check.amounts import amount, duration, root_density
from navfilter.check.finding import Finding
from navfilter.constants import ROOT_HOUR
from navfilter.error_models import Arma, ErrorModel, GaussMarkov, RandomWalk, Sum, White
from navfilter.filter.layout import Layout
from navfilter.learning.learned import LearnedArma
from navfilter.mechanisation import Imu
from navfilter.sensors import BodyVelocity, Depth, Heading, Position, WaterVelocity, ZeroVelocity

if TYPE_CHECKING:
    from navfilter.vehicle import Vehicle

__all__ = ["check_vehicle"]


@dataclass(frozen=True)
class _Channel:
    """What is usual for one kind of channel, in SI: beyond it a number was probably meant in another unit."""

    unit: str
    least_sd: float
    most_sd: float
    suffix: str = ""
    most_density: float = math.inf
    density_suffix: str = ""
    most_rate_hz: float = 1000.0
    hint: str = ""


#: The limits are generous: beyond the worst and the best of instruments on the market.
_GYRO = _Channel("rad_s", 1e-8, 0.09, "deg_per_h", 6e-3, "deg_per_sqrt_h")  # 5 deg/s; 20 deg/sqrt(h)
_ACCEL = _Channel("m_s2", 1e-7, 0.5, "mg", 0.05, "mg_per_sqrt_hz")  # 50 mg; 5 mg/sqrt(Hz)
_VELOCITY = _Channel("m_s", 1e-4, 0.5, "cm_per_s", most_rate_hz=100.0)
_HEADING = _Channel("rad", 1e-5, math.radians(30.0), "deg", most_rate_hz=200.0)
_TILT = _Channel("rad", 1e-7, math.radians(15.0), "deg", most_rate_hz=1000.0)
_DEPTH = _Channel("m", 1e-4, 10.0, "cm", most_rate_hz=200.0)
_POSITION = _Channel("m", 3e-3, 1000.0, "", most_rate_hz=50.0, hint="Errors of fixes are in metres, not in degrees or radians.")
_OF_SENSORS: dict[type, _Channel] = {
    BodyVelocity: _VELOCITY,
    Heading: _HEADING,
    Depth: _DEPTH,
    Position: _POSITION,
    ZeroVelocity: _VELOCITY,
}
_MANY_STATES = 120


def check_vehicle(vehicle: Vehicle) -> tuple[Finding, ...]:
    """What looks wrong in a vehicle, the gravest first.

    Parameters
    ----------
    vehicle : Vehicle

    Returns
    -------
    tuple of Finding
        `Finding.stream` is the place in the vehicle.toml. Severity "warning": probably a mistake; "info": worth knowing.

    Examples
    --------
    >>> from navfilter import Heading, Imu, Vehicle, White
    >>> found = check_vehicle(Vehicle(imu=Imu(rate_hz=100), sensors={"compass": Heading(error=White(sd=0.6))}))
    >>> found[0].stream, found[0].cure
    ('sensors.compass.error.sd', 'If 0.6 deg is meant, write sd_deg = 0.6.')
    """
    found = [*_drive_findings(vehicle.drive)]
    for name, sensor in vehicle.sensors.items():
        found += _sensor_findings(f"sensors.{name}", sensor)
    found += _whole_findings(vehicle)
    rank = {"error": 0, "warning": 1, "info": 2}
    return tuple(sorted(dict.fromkeys(found), key=lambda finding: rank[finding.severity]))


def _warn(place: str, text: str, cure: str) -> Finding:
    return Finding("warning", place, text, cure)


# --- drive and sensors ------------------------------------------------------------------------------------------------


def _drive_findings(drive: Any) -> Iterator[Finding]:
    if isinstance(drive, Imu):
        if not 10.0 <= drive.rate_hz < 1000.0:
            cure = "It is in Hz: the samples per second of the stream. Below 10 Hz turns are lost; average what is faster than 1 kHz."
            yield _warn("drive.rate_hz", f"an inertial unit at {drive.rate_hz:g} Hz is unusual.", cure)
        yield from _errors("drive.gyro", drive.gyro, drive.models[:3], _GYRO, drive.period_s)
        yield from _errors("drive.accel", drive.accel, drive.models[3:], _ACCEL, drive.period_s)
        for name, part in (("gyro", drive.models[:3]), ("accel", drive.models[3:])):
            if not any(model.block(drive.period_s).size for model in part):
                cure = f'Add {{model = "random-walk", density = .., start_sd = ..}} to {name}, as a list.'
                yield Finding("info", f"drive.{name}", "only white noise, no bias is estimated; every inertial unit has one.", cure)
        return
    if not 0.1 <= drive.rate_hz <= 100.0:
        yield _warn(
            "drive.rate_hz", f"dead reckoning at {drive.rate_hz:g} Hz is unusual.", "It is in Hz: the velocity readings per second."
        )
    heading = drive.attitude if isinstance(drive.attitude, Heading) else None
    if heading is not None:
        yield from _errors("drive.attitude.error", heading.error, drive.models[2:3], _HEADING, drive.period_s)
        yield from _errors("drive.tilt", drive.tilt, drive.models[:1], _TILT, drive.period_s)
        yield from _heading_findings("drive.attitude", heading)
        if heading.temperature_sd_rad_per_k:
            yield _warn("drive.attitude.temperature_sd_rad_per_k", "dead reckoning estimates no drift with temperature.", "Leave it out.")
    else:
        yield from _errors("drive.attitude", drive.attitude, drive.models[:3], _HEADING, drive.period_s)
    sensor, place = drive.velocity_sensor, "drive.velocity"
    error = f"{place}.error" if isinstance(drive.velocity, BodyVelocity) else place
    yield from _errors(error, sensor.error, drive.models[3:], _VELOCITY, drive.period_s)
    yield from _fitting_findings(place, sensor)


def _sensor_findings(place: str, sensor: Any) -> Iterator[Finding]:
    channel = next((known for cls, known in _OF_SENSORS.items() if isinstance(sensor, cls)), None)
    if channel is not None:
        if sensor.rate_hz > channel.most_rate_hz:
            text = f"{sensor.rate_hz:g} Hz is unusual for this kind of sensor."
            yield _warn(f"{place}.rate_hz", text, "It is in Hz, the readings per second; a held value that is repeated is no new reading.")
        yield from _errors(f"{place}.error", sensor.error, sensor.models, channel, 1.0 / sensor.rate_hz)
    if isinstance(sensor, Heading):
        yield from _heading_findings(place, sensor)
    yield from _fitting_findings(place, sensor)
    if isinstance(sensor, WaterVelocity):
        yield from _current_findings(place, sensor)
    if sensor.gate_probability < 0.95:
        share = 1.0 - sensor.gate_probability
        yield _warn(f"{place}.gate_probability", f"refuses {100.0 * share:.3g} % of good readings.", "Usual: 0.999 or 0.9999.")


def _heading_findings(place: str, sensor: Heading) -> Iterator[Finding]:
    for name, value in (("bias_sd_rad", sensor.bias_sd_rad), ("deviation_sd_rad", max(sensor.deviation_sd_rad))):
        if value > math.radians(60.0):
            yield _angle(f"{place}.{name}", value)
    if sensor.declination_rad is not None and abs(sensor.declination_rad) > math.pi:
        yield _angle(f"{place}.declination_rad", sensor.declination_rad)


def _current_findings(place: str, sensor: WaterVelocity) -> Iterator[Finding]:
    if sensor.current_sd_m_s > 3.0:
        text = f"a current of {sensor.current_sd_m_s:.4g} m/s is faster than all but the strongest tidal streams."
        yield _warn(f"{place}.current_sd_m_s", text, "It is in m/s; for cm/s write current_sd_cm_per_s.")
    if sensor.current_tau_s < 60.0:
        text = f"a current that is another one after {duration(sensor.current_tau_s)} carries no position."
        yield _warn(f"{place}.current_tau_s", text, "It is in seconds; currents last for hours. Eddies and waves belong to error.")


def _fitting_findings(place: str, sensor: Any) -> Iterator[Finding]:
    lever = math.hypot(*getattr(sensor, "lever_arm_b_m", (0.0,)))
    if lever > 30.0:
        cure = "Lever arms are in metres, forward, right, down; for millimetres write lever_arm_b_mm."
        yield _warn(f"{place}.lever_arm_b_m", f"the sensor is {lever:.4g} m away from the reference point.", cure)
    if max(map(abs, getattr(sensor, "mounting_rad", (0.0,)))) > 2.0 * math.pi:
        yield _angle(f"{place}.mounting_rad", max(sensor.mounting_rad, key=abs))
    if getattr(sensor, "misalignment_sd_rad", 0.0) > math.radians(20.0):
        yield _angle(f"{place}.misalignment_sd_rad", sensor.misalignment_sd_rad)
    if getattr(sensor, "scale_sd", 0.0) > 0.2:
        cure = "It is a pure number: 1 % is 0.01."
        yield _warn(f"{place}.scale_sd", f"a scale error of {100.0 * sensor.scale_sd:.4g} % is unusual.", cure)


def _angle(place: str, value: float) -> Finding:
    key = place.rsplit(".", 1)[-1].replace("_rad", "_deg")
    return _warn(place, f"{value:.4g} rad are {math.degrees(value):.4g} deg.", f"If {value:.4g} deg is meant, write {key}, in degrees.")


def _whole_findings(vehicle: Vehicle) -> Iterator[Finding]:
    kinds = {type(sensor) for sensor in vehicle.sensors.values()}
    size = Layout.of(vehicle).size
    if size > _MANY_STATES:
        cure = "The cost grows with the square of the states: lower orders, or one model for all axes."
        yield _warn("", f"{size} states are many.", cure)
    if not kinds & {Position}:
        yield Finding("info", "sensors", "no position fixes: the error of the position grows without bound.", "")
    if isinstance(vehicle.drive, Imu):
        if not kinds & {Position, BodyVelocity, WaterVelocity, ZeroVelocity}:
            cure = "Add a sensor of type body-velocity or position: without one an inertial unit is lost within minutes."
            yield _warn("sensors", "nothing corrects position or velocity.", cure)
        if Heading not in kinds:
            yield Finding("info", "sensors", "no compass: the heading is only seen through fixes while the vehicle accelerates.", "")
    elif ZeroVelocity in kinds:
        place = next(f"sensors.{name}" for name, sensor in vehicle.sensors.items() if isinstance(sensor, ZeroVelocity))
        yield _warn(place, "rest is detected from an inertial unit; dead reckoning has none.", "Leave it out.")


# --- error models -----------------------------------------------------------------------------------------------------


def _errors(place: str, given: Any, models: tuple[ErrorModel, ...], channel: _Channel, period_s: float) -> Iterator[Finding]:
    """Findings on one error as given: a model for all axes, or one for each."""
    several = isinstance(given, tuple)
    for k, model in enumerate(models if several else models[:1]):
        here = f"{place}.{'xyz'[k]}" if several else place
        parts = model.parts if isinstance(model, Sum) else (model,)
        for j, part in enumerate(parts):
            yield from _part_findings(f"{here}[{j}]" if len(parts) > 1 else here, part, channel, period_s)
        block = model.block(period_s)
        total = math.sqrt(float(block.C @ block.P0 @ block.C) + block.r)
        if total < channel.least_sd:
            size = "nothing" if total == 0.0 else f"only {amount(total, channel.unit)}"
            cure = channel.hint or f"A filter believes such a sensor blindly: give the sd in SI, or in another unit as sd_{channel.suffix}."
            yield _warn(here, f"errs by {size} in all.", cure)


def _part_findings(place: str, part: ErrorModel, channel: _Channel, period_s: float) -> Iterator[Finding]:
    if isinstance(part, White) and part.density is not None:
        if part.density > channel.most_density:
            yield _too_large(f"{place}.density", part.density, root_density(part.density, channel.unit), channel.density_suffix)
        elif math.isinf(channel.most_density):
            yield from _sd_findings(f"{place}.density", part.density / math.sqrt(period_s), channel)
    elif isinstance(part, White | GaussMarkov):
        yield from _sd_findings(f"{place}.sd", float(part.sd or 0.0), channel)
    elif isinstance(part, RandomWalk):
        if part.start_sd is not None:
            yield from _sd_findings(f"{place}.start_sd", part.start_sd, channel)
        if ROOT_HOUR * part.density > channel.most_sd:
            cure = "The density is per second and root Hertz: (change in an hour) / 60."
            yield _warn(f"{place}.density", f"a bias that wanders by {amount(ROOT_HOUR * part.density, channel.unit)} in an hour.", cure)
    elif isinstance(part, Arma) or (isinstance(part, LearnedArma) and part.model is not None):
        block = part.block(period_s)
        yield from _sd_findings(place, math.sqrt(float(block.C @ block.P0 @ block.C) + block.r), channel)
    elif isinstance(part, LearnedArma):
        if part.window * period_s > 7200.0:
            cure = f"A window of {max(int(1800.0 / period_s), 200)} readings takes half an hour or less; models of slow sensors need fewer."
            yield _warn(f"{place}.window", f"{part.window} readings are {duration(part.window * period_s)} of this sensor.", cure)
        for k, prior in enumerate(getattr(part.prior, "parts", (part.prior,))):
            if prior is not None:
                inner = f"{place}.prior[{k}]" if isinstance(part.prior, Sum) else f"{place}.prior"
                yield from _part_findings(inner, prior, channel, period_s)
    if isinstance(part, GaussMarkov):
        if part.tau_s < period_s:
            text = f"a correlation time of {duration(part.tau_s)} is shorter than the time between two readings, {duration(period_s)}."
            yield _warn(f"{place}.tau_s", text, "Between readings nothing is left of it: use white.")
        elif part.tau_s > 1e5:
            yield _warn(f"{place}.tau_s", f"a correlation time of {duration(part.tau_s)}.", "It is in seconds. For a bias use random-walk.")


def _sd_findings(place: str, sd: float, channel: _Channel) -> Iterator[Finding]:
    if sd > channel.most_sd:
        yield _too_large(place, sd, amount(sd, channel.unit), channel.suffix, channel.hint)


def _too_large(place: str, value: float, shown: str, suffix: str, hint: str = "") -> Finding:
    key = place.rsplit(".", 1)[-1].split("[")[0]
    if key == "density" and "sqrt" not in suffix:
        key = "sd"  # what was judged is the sd of a reading
    unit = suffix.replace("_per_sqrt_", "/sqrt(").replace("_per_", "/")
    unit = f"{unit})" if "(" in unit else unit
    cure = hint or f"If {value:.3g} {unit.replace('sqrt(hz)', 'sqrt(Hz)')} is meant, write {key}_{suffix} = {value:.3g}."
    if key == "error":
        cure = "The sd of an ARMA model is that of its innovations, in SI: look at the poles too."
    return _warn(place, f"{shown} ({value:.3g} in SI) is far more than such a sensor errs by.", cure)
