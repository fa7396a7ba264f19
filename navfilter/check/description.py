"""A vehicle in plain words: what drives it, its sensors, and what their error models mean."""

import math
from collections.abc import Iterator, Sequence
from itertools import groupby
from typing import Any

import numpy as np

from navfilter.check.units_text import amount, duration, root_density, walk
from navfilter.filter.state_layout import Layout
from navfilter.foundation.constants import ROOT_HOUR
from navfilter.learning.open_loop_series import TAKEN_AFTER_S
from navfilter.learning.schedule import LearningSchedule
from navfilter.models import error_models
from navfilter.models.error_models import Arma, Block, Cycle, ErrorModel, GaussMarkov, RandomWalk, White, sum_of
from navfilter.models.learned_arma import LearnedArma
from navfilter.models.mechanisation import Mechanisation
from navfilter.models.parameters import Parameter, constant_parameters
from navfilter.models.sensors import Sensor
from navfilter.models.vehicle import DEAD_RECKONING, Vehicle
from navfilter.models.window_limits import least_window
from navfilter.navigation.navigator import Navigator

_ORDERS = {1: "first", 2: "second", 3: "third", 4: "fourth"}
_COLUMN = 13


def describe_vehicle(vehicle: Vehicle) -> str:
    """Drive, sensors, error models and number of states in plain words.

    Parameters
    ----------
    vehicle : Vehicle

    Returns
    -------
    str
        Several lines.

    Examples
    --------
    >>> from navfilter import Depth, Imu, Vehicle, White
    >>> vehicle = Vehicle(imu=Imu(rate_hz=100), sensors={"depth": Depth(error=White(sd=0.05))})
    >>> print(describe_vehicle(vehicle).splitlines()[0])
    Vehicle "vehicle": 15 states (9 of navigation, 6 of the drive), 1 sensor.
    """
    layout = Layout.of(vehicle)
    counts = [f"9 of navigation, {layout.drive.size} of the drive"] + [
        f"{g.size} of {name}" for name, g in layout.groups.items() if g.size
    ]
    number = len(vehicle.sensors)
    lines = [
        f'Vehicle "{vehicle.name}": {layout.size} states ({", ".join(counts)}), {number} '
        f"sensor{'' if number == 1 else 's'}.",
        "",
    ]
    if not vehicle.imus:
        lines += _drive_lines("Drive", vehicle.drive, vehicle.drive.streams)
    for name, unit in vehicle.imus.items():
        lines += [*_drive_lines(f'Unit "{name}"', unit, (name,)), ""]
    if lanes := list(vehicle.lanes()):
        lines += _lane_lines(lanes, vehicle.dead_reckoning_lane is None)
    for name, sensor in vehicle.sensors.items():
        lines += ["", *_sensor_lines(name, sensor)]
    return "\n".join(lines)


def _lane_lines(lanes: list[str], by_itself: bool) -> Iterator[str]:
    """Filters that run side by side."""
    yield f"Lanes: {', '.join(lanes)}; a filter each, which cost as much as {len(lanes)} vehicles with one drive."
    if DEAD_RECKONING in lanes:
        why = " (that is usual for several units; dead_reckoning_lane = false leaves it out)" if by_itself else ""
        yield f"  {DEAD_RECKONING} goes by heading and velocity alone{why}"
    elif by_itself:
        yield "  dead reckoning is not among them: it needs a heading and a velocity"


def _drive_lines(title: str, drive: Mechanisation, names: Sequence[str]) -> Iterator[str]:
    streams = " and ".join(f'"{stream}"' for stream in names)
    yield f"{title}: {drive.words} (stream{'s' if len(names) > 1 else ''} {streams})"
    models = drive.models if drive.inertial else tuple(_not_learnt(model) for model in drive.models)
    for name, part in zip(drive.triples, (slice(0, 3), slice(3, 6)), strict=True):
        yield from _error_lines(name, models[part], drive.axis_names[part], drive.units[part], drive.period_s)
    if drive.compass is not None:
        yield from _north_lines(drive.compass)
    if drive.velocity_sensor is not None:
        yield from _fitting_lines(drive.velocity_sensor)
    wandering = drive.wandering()
    yield from _parameter_lines(constant_parameters(drive.all_parameters(), wandering))
    units = {p.name: p.unit for p in drive.parameters()}
    yield from _wandering_lines(wandering, units, drive.period_s)


def _not_learnt(model: ErrorModel) -> ErrorModel:
    """The prior in place of what would be learnt: of readings that drive nothing is."""
    known = [part.prior if isinstance(part, LearnedArma) and part.model is None else part for part in model.terms]
    given = [part for part in known if part is not None]
    return sum_of(given) if given else model


def _sensor_lines(name: str, sensor: Sensor) -> Iterator[str]:
    yield f'Sensor "{name}": {sensor.words}, {sensor.rate_hz:g} Hz'
    yield from _error_lines("error", sensor.models, sensor.axis_names, sensor.units, 1.0 / sensor.rate_hz)
    yield from _north_lines(sensor)
    yield from _fitting_lines(sensor)
    yield from _clock_lines(sensor)
    wandering = sensor.wandering()
    yield from _parameter_lines(constant_parameters(sensor.all_parameters(), wandering))
    yield from _wandering_lines(wandering, {p.name: p.unit for p in sensor.parameters()}, 1.0 / sensor.rate_hz)
    share = 1.0 - sensor.gate_probability
    yield _line(
        "gate",
        f"refuses one good reading in {1.0 / share:.0f}; widens after {duration(sensor.gate_timeout_s)} of refusals",
    )


def _error_lines(
    name: str, models: tuple[ErrorModel, ...], axis_names: tuple[str, ...], units: tuple[str, ...], period_s: float
) -> Iterator[str]:
    """One paragraph for neighbouring axes that err alike."""
    for (model, unit), group in groupby(zip(models, units, axis_names, strict=True), key=lambda axis: axis[:2]):
        axes = [axis for *_, axis in group]
        some = f"{axes[0]} to {axes[-1]}" if len(axes) > 2 else " and ".join(axes)
        label = name if len(axes) == len(models) or not some else f"error {some}" if name == "error" else some
        for k, text in enumerate(describe_error(model, unit, period_s, at_rest=name in ("gyro", "accel"))):
            yield _line(label if k == 0 else "", text)


def _north_lines(sensor: Any) -> Iterator[str]:
    """From where a magnetic heading counts, and how well that is known."""
    if not (getattr(sensor, "magnetic", False) or getattr(sensor, "magnetometer", False)):
        return
    given, sd = sensor.declination_rad, sensor.declination_sd_rad
    text = "declination of the World Magnetic Model" if given is None else f"declination {amount(given, 'rad')}"
    if sd is not None:
        text += f", sd {amount(sd, 'rad')}"
    elif given is None:
        text += " (it errs by 0.3 to 0.9 deg: a state near the magnetic poles only)"
    else:
        text += ", taken as exact"
    yield _line("north", f"magnetic, {text}")


def _fitting_lines(sensor: Any) -> Iterator[str]:
    lever, mounting = getattr(sensor, "lever_arm_b_m", None), getattr(sensor, "mounting_rad", None)
    if lever is not None and any(lever):
        forward, right, down = lever
        yield _line("lever arm", f"{forward:g} m forward, {right:g} m right, {down:g} m down of the reference point")
    if mounting is not None and any(mounting):
        yield _line(
            "mounting",
            "roll {:g}, pitch {:g}, yaw {:g} deg".format(*(round(math.degrees(angle), 6) for angle in mounting)),
        )


def _clock_lines(sensor: Sensor) -> Iterator[str]:
    if sensor.time_offset_s:
        yield _line(
            "clock", f"its stamps are {abs(sensor.time_offset_s):g} s {'late' if sensor.time_offset_s > 0 else 'early'}"
        )


def _parameter_lines(parameters: tuple[Parameter, ...]) -> Iterator[str]:
    """Constant states: those that may differ from zero."""
    texts = [f"{p.name} {amount(p.sd, p.unit)}" for p in parameters if p.sd]
    if texts:
        yield _line("constants", f"estimated, sd at the start: {', '.join(texts)}")


def _wandering_lines(wandering: dict[str, ErrorModel], units: dict[str, str], period_s: float) -> Iterator[str]:
    """States that are not constant, with how they wander."""
    for key, model in wandering.items():
        texts = " + ".join(_part(part, units[key], period_s) for part in model.terms)
        yield _line(key.replace("_", " "), f"estimated, {texts}")


def _line(label: str, text: str) -> str:
    return f"  {label:{_COLUMN}}{text}" if len(label) < _COLUMN else f"  {label} {text}"


def describe_error(model: ErrorModel, unit: str, period_s: float, at_rest: bool = False) -> list[str]:
    """What an error model says: a line per part, then what it means at low frequencies.

    Parameters
    ----------
    model : ErrorModel
    unit : str
        Of the channel, as in `Layout.units`.
    period_s : float
        Sampling period of the sensor [s].
    at_rest : bool
        A learnt part is learnt while the vehicle keeps still, as of gyros and accelerometers.

    Returns
    -------
    list of str

    Examples
    --------
    >>> describe_error(GaussMarkov(sd=0.1, tau_s=30.0), "m", 1.0)[0]
    'Gauss-Markov of first order: sd 0.1 m, correlation time 30 s'
    """
    lines = []
    for k, part in enumerate(model.terms):
        lines.append(f"{'+ ' if k else ''}{_part(part, unit, period_s, at_rest)}")
        if isinstance(part, LearnedArma) and part.model is None and part.prior is not None:
            before = [_part(inner, unit, period_s) for inner in part.prior.terms]
            within = part.prior_within
            so_far = f"; believed within a factor of {within[0]:g} in sd, {within[1]:g} in time" if within else ""
            lines.append(f"  until then {' + '.join(before)}{so_far}")
    return [*lines, *_low_frequencies(model.block(period_s), unit, period_s)]


def _part(model: ErrorModel, unit: str, period_s: float, at_rest: bool = False) -> str:
    if isinstance(model, White):
        if model.density is None:
            return f"white noise: sd {amount(float(model.sd or 0.0), unit)} of a reading"
        return (
            f"white noise: {root_density(model.density, unit)}, sd "
            f"{amount(model.density / math.sqrt(period_s), unit)} of a reading"
        )
    if isinstance(model, RandomWalk):
        start = ROOT_HOUR * model.density if model.start_sd is None else model.start_sd
        if not model.density:
            return f"constant bias: sd {amount(start, unit)}"
        return f"bias: sd {amount(start, unit)} at the start, wanders by {walk(model.density, unit)}"
    if isinstance(model, GaussMarkov):
        return (
            f"Gauss-Markov of {_ORDERS[model.order]} order: sd {amount(model.sd, unit)}, correlation time "
            f"{duration(model.tau_s)}"
        )
    if isinstance(model, Cycle):
        swing = f"swing of {duration(model.period_s)}: sd {amount(model.sd, unit)}"
        return f"{swing}, another one after {duration(model.tau_s)}"
    if isinstance(model, Arma):
        return _arma("ARMA", (len(model.ar), len(model.ma)), model, unit, period_s)
    if isinstance(model, LearnedArma):
        return _learned(model, unit, period_s, at_rest)
    return str(model)


def _arma(name: str, order: tuple[int, int], model: ErrorModel, unit: str, period_s: float) -> str:
    block = model.block(period_s)
    times = _time_constants(block, period_s)
    total = math.sqrt(block.variance)
    return f"{name}({order[0]}, {order[1]}): sd {amount(total, unit)}{'; ' if times else ''}{', '.join(times)}"


def _learned(model: LearnedArma, unit: str, period_s: float, at_rest: bool) -> str:
    if model.model is not None:
        return _arma("learnt ARMA", (model.model.p, model.model.q), model, unit, period_s)
    orders = ", ".join(f"({p},{q})" for p, q in model.orders)
    span, first = duration(model.window * period_s), duration(_first_after_s(model, period_s, at_rest))
    under = "at rest" if at_rest else "under way"
    return f"learnt {under} from the last {span}, first after {first}{' of it' if at_rest else ''}, orders {orders}"


def _first_after_s(model: LearnedArma, period_s: float, at_rest: bool) -> float:
    """When a model is first adopted, where no reading is missing [s]; at rest this much of it is needed."""
    if at_rest:
        return 0.5 * model.window * period_s if model.hop is None else model.hop * period_s
    # what a late reading may still change is not learnt from
    behind_s = Navigator.HISTORY_S
    heard_s = least_window(sum(model.orders[0])) * period_s + behind_s
    return min((age_s for age_s in LearningSchedule.EARLY_S if age_s >= heard_s), default=heard_s) + TAKEN_AFTER_S


def _time_constants(block: Block, period_s: float) -> list[str]:
    """Decay times, and periods of oscillations, of the poles."""
    found = []
    for pole in sorted(np.linalg.eigvals(block.Phi), key=lambda pole: -abs(pole)) if block.size else []:
        if abs(pole) < 1e-6 or pole.imag < 0.0:
            continue
        decay = duration(-period_s / math.log(abs(pole))) if abs(pole) < 1.0 else "never"
        if abs(pole.imag) > 1e-9:
            found.append(
                f"swings with a period of {duration(2.0 * math.pi * period_s / float(np.angle(pole)))}, decays in "
                f"{decay}"
            )
        elif pole.real > 0.0:
            found.append(f"time constant {decay}")
    return found


def zero_frequency(block: Block, period_s: float) -> float:
    """Root of the spectral density at zero frequency [unit/sqrt(Hz)]; infinite for a random walk.

    The spectrum is two-sided, as that of `White.density`: the mean over a long time T then has the variance ``S(0) /
    T``.

    Parameters
    ----------
    block : Block
    period_s : float
        Sampling period [s].

    Examples
    --------
    >>> round(zero_frequency(White(density=0.3).block(0.1), 0.1), 9)
    0.3
    """
    if block.size and float(np.abs(np.linalg.eigvals(block.Phi)).max()) > 1.0 - 1e-12:
        return math.inf
    return math.sqrt(max(error_models.block_level(block), 0.0) * period_s)


def _low_frequencies(block: Block, unit: str, period_s: float) -> Iterator[str]:
    if not block.size:
        return
    root = zero_frequency(block, period_s)
    if math.isinf(root):
        return
    slowest = -period_s / math.log(max(float(np.abs(np.linalg.eigvals(block.Phi)).max()), 1e-12))
    # The mean obeys S(0)/T only over times that are long beside the slowest memory.
    over = next((T for T in (60.0, 600.0, 3600.0, 36000.0) if max(5.0 * slowest, 2.0 * period_s) <= T), None)
    mean = (
        "" if over is None else f": the mean of {duration(over)} still errs by {amount(root / math.sqrt(over), unit)}"
    )
    yield f"  at low frequencies {root_density(root, unit)}, the root of S(0){mean}"
