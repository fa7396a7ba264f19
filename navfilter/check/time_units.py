"""Times in another unit than they were read in: a stream that lasts, or ticks, a thousand times too long; times of
another clock.
"""

from collections.abc import Iterator

import numpy as np

from navfilter.check.finding import Finding
from navfilter.models.mission import Mission, Stream
from navfilter.models.vehicle import Vehicle

#: Units of stamps that are mistaken for seconds: how many of them make one.
_PER_SECOND = {"ms": 1e3, "us": 1e6, "ns": 1e9}
#: Slower than this no inertial unit is sampled [s].
_SLOWEST_IMU_S = 0.5
#: Nobody switches a sensor off and another one on so long afterwards [s].
_BESIDE_S = 300.0


def clock_findings(mission: Mission, vehicle: Vehicle | None) -> Iterator[Finding]:
    """Streams whose times are in another unit: against the other streams, and against the rates of the vehicle."""
    steps = {name: _usual_step_s(stream) for name, stream in mission.streams.items() if _lasts(stream)}
    spans = {name: _span_s(mission.streams[name]) for name in steps}
    rates = {} if vehicle is None else _rates_hz(vehicle)
    yield from _apart(mission, list(steps))
    for name, step_s in steps.items():
        others = [span for other, span in spans.items() if other != name]
        if mission.truth is not None and _lasts(mission.truth):
            others.append(_span_s(mission.truth))
        longer = spans[name] / float(np.median(others)) if others else 1.0
        slower = step_s * rates.get(name, 1.0 / step_s)
        where = f"time of [streams.{name}]"
        for unit, count in _PER_SECOND.items():
            if _about(longer, count):
                text = f"its readings last {spans[name]:.4g} s, those of the others {spans[name] / longer:.4g} s."
            elif _about(slower, count):
                text = f"a reading every {step_s:.4g} s, where the vehicle has {rates[name]:.4g} in a second."
            elif (
                "force_x_m_s2" in mission.streams[name].columns
                and 1e-4 < step_s / count < 0.1
                and step_s > _SLOWEST_IMU_S
            ):
                text = f"an inertial unit with a sample every {step_s:.4g} s."
            elif _about(1.0 / slower, count):
                text = f"{1.0 / step_s:.4g} readings in a second, where the vehicle has {rates[name]:.4g}."
                cure = f'Are these seconds? Then unit = "s" in {where}, not "{unit}".'
                yield Finding("error", "clock-unit", name, text, cure)
                break
            else:
                continue
            cure = f'Are these {unit}, read as seconds? Then unit = "{unit}" in {where}.'
            yield Finding("error", "clock-unit", name, text, cure)
            break


def _apart(mission: Mission, names: list[str]) -> Iterator[Finding]:
    """A stream whose readings lie beside those of all others."""
    if len(names) < 3:
        return
    ends = {name: (mission.streams[name].time_s[0], mission.streams[name].time_s[-1]) for name in names}
    for name, (begin, end) in ends.items():
        others = [other for key, other in ends.items() if key != name]
        together = max(b for b, _ in others) < min(e for _, e in others)
        first, last = min(b for b, _ in others), max(e for _, e in others)
        if together and (begin > last + _BESIDE_S or end < first - _BESIDE_S):
            text = f"its readings lie from {begin:.6g} to {end:.6g} s,"
            text += f" those of the others from {first:.6g} to {last:.6g} s."
            cure = f"Another time zone, epoch or unit? Set offset_s in time of [streams.{name}]."
            yield Finding("error", "clock", name, text, cure)


def _lasts(stream: Stream) -> bool:
    return len(stream) > 1 and bool(stream.time_s[-1] > stream.time_s[0])


def _span_s(stream: Stream) -> float:
    return float(stream.time_s[-1] - stream.time_s[0])


def _usual_step_s(stream: Stream) -> float:
    step = np.diff(stream.time_s)
    return float(np.median(step[step > 0.0]))


def _rates_hz(vehicle: Vehicle) -> dict[str, float]:
    drives = {name: drive.rate_hz for name, drive in vehicle.driving.items()}
    return drives | {name: sensor.rate_hz for name, sensor in vehicle.sensors.items()}


def _about(ratio: float, count: float) -> bool:
    return 0.5 * count < ratio < 2.0 * count
