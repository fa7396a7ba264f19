"""A commented vehicle.toml to start from: every key with its unit and its default.

A line that begins with ``#key`` states a default: taking the ``#`` away changes nothing. Lines that begin with ``# `` are
words. The words and the defaults come from the classes themselves.
"""

import dataclasses
import inspect
import math
import re
import textwrap
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from navfilter.io.units import SUFFIXES
from navfilter.models.mechanisation import DeadReckoning, Imu
from navfilter.models.sensors import BodyVelocity, Heading, Sensor
from navfilter.models.sensors.traits import EXAMPLES, kind_name, kinds_below

DRIVES = ("imu", "imus", "dead-reckoning")
_WIDTH = 130
_TEXTS = re.split(r"^==== (\w+)\n", Path(__file__).with_suffix(".txt").read_text("utf-8"), flags=re.MULTILINE)
#: What the classes do not say, by name.
_SAID = dict(zip(_TEXTS[1::2], _TEXTS[2::2], strict=True))
#: The errors of an inertial unit.
_GYRO_ACCEL = _SAID["gyro"].rstrip("\n"), _SAID["accel"].rstrip("\n")


def vehicle_template(drive: str = "imu") -> str:
    """The text of a vehicle.toml with every key, commented.

    Parameters
    ----------
    drive : {"imu", "imus", "dead-reckoning"}
        What carries the state between corrections: "imus" is two inertial units, with lanes.

    Returns
    -------
    str
        Reads back as a vehicle with compass, DVL, depth gauge and GPS.

    Raises
    ------
    ValueError
        For another drive.

    Examples
    --------
    >>> "[drive]" in vehicle_template("dead-reckoning")
    True
    """
    if drive not in DRIVES:
        raise ValueError(f'there is no drive "{drive}" (known: {", ".join(DRIVES)}).')
    suffixes = "\n".join(textwrap.wrap(", ".join(SUFFIXES), _WIDTH, initial_indent="#   ", subsequent_indent="#   "))
    parts = [
        _SAID["head"].replace("<endings>", suffixes),
        'name = "example AUV"\n',
        *{"imu": _inertial, "imus": _units, "dead-reckoning": _reckoning}[drive](),
    ]
    parts += [_correcting(kind) for kind in _shown(drive)]
    return "\n".join(parts)


def _shown(drive: str) -> list[Any]:
    """The kinds of correcting sensors to show: those that bring a template, but for what dead reckoning is made of."""
    kinds: list[Any] = [kind for kind in kinds_below(Sensor) if "template" in vars(kind)]
    others = [kind for kind in kinds if kind.observes.corrects not in ("heading", "velocity") and not kind.from_drive]
    return others if drive == "dead-reckoning" else kinds


def _correcting(kind: Any) -> str:
    example = kind.template
    section = _section(
        f"sensors.{example.name}", kind, example.words, example.rate_hz, *example.lines, lever=example.lever_arm
    )
    return section if example.live else _unused(section)


def _inertial() -> Iterator[str]:
    words = 'What carries the state between corrections: an inertial unit (stream "imu"), strapdown on WGS-84.'
    yield _SAID["beside"]
    yield _section("drive", Imu, words, 100, *_GYRO_ACCEL)
    yield _SAID["sensors"]


def _units() -> Iterator[str]:
    yield _SAID["units"]
    words = 'The first unit: "a" is the name of its stream. Strapdown on WGS-84.'
    yield _section("imus.a", Imu, words, 100, *_GYRO_ACCEL)
    yield "\n".join(
        ["# The second unit, with the same keys.", "[imus.b]", 'type = "imu"', "rate_hz = 100", *_GYRO_ACCEL, ""]
    )
    yield _SAID["sensors"]


def _unused(section: str) -> str:
    """A table that is there to be uncommented."""
    return re.sub(r"^(?=[^#\n])", "#", section, flags=re.MULTILINE)


def _reckoning() -> Iterator[str]:
    words = 'What carries the state between corrections: attitude and body velocity (streams "attitude" and "velocity"), no inertial unit.'
    yield _section(
        "drive", DeadReckoning, words, 5, 'tilt = {model = "white", sd_deg = 0.3}', without={"attitude", "velocity"}
    )
    # What corrects nothing has no gate; a magnetometer cannot be levelled here, and a drift with temperature has no state.
    unused = {"rate_hz", "gate_probability", "gate_timeout_s"}
    iron = {"magnetometer", "hard_iron", "soft_iron", "hard_iron_sd", "soft_iron_sd"}
    iron |= {"temperature_sd_rad_per_k", "reference_temperature_c"}
    yield _section(
        "drive.attitude",
        Heading,
        "The heading, with its error.",
        None,
        'type = "heading"',
        EXAMPLES["compass"].lines[0],
        without=unused | iron,
    )
    yield _section(
        "drive.velocity",
        BodyVelocity,
        "The body velocity.",
        None,
        'type = "body-velocity"',
        *EXAMPLES["dvl"].lines,
        lever=(0.5, 0.0, 0.1),
        without=unused,
    )
    yield _SAID["sensors"]


def _section(
    name: str,
    cls: Any,
    words: str,
    rate_hz: float | None,
    *live: str,
    lever: Sequence[float] | None = None,
    without: set[str] | None = None,
) -> str:
    """One table: what is set, then every other key of the class at its default."""
    lines = [*_wrapped(words), f"[{name}]"]
    texts = _parameters(cls)
    if rate_hz is not None:
        lines += [f'type = "{kind_name(cls)}"', f"rate_hz = {rate_hz}"]
    lines += live
    given = {match.group(1) for line in lines if (match := re.match(r"(\w+) = ", line))} | (without or set())
    if lever is not None:
        lines += [*_wrapped(texts["lever_arm_b_m"][1]), f"lever_arm_b_m = {list(lever)}"]
        given.add("lever_arm_b_m")
    given |= _not_for(cls)
    # What all sensors share is explained once, with the first of them; a kind of another sensor shares all of that.
    said = set() if cls in (Imu, DeadReckoning, Heading) else {group for group, _ in _parameters(cls.__base__).values()}
    if cls.__base__ is Sensor:
        said.discard(texts["lever_arm_sd_m"][0])  # the first of them has none
    for field in dataclasses.fields(cls):
        if field.name in given or not field.init:
            continue
        group, text = texts[field.name]
        if group not in said:
            said.add(group)
            lines += _wrapped(text)
        lines.append(_default(field))
    return "\n".join(lines) + "\n"


def _not_for(cls: Any) -> set[str]:
    """What all sensors share, but those without a lever arm or a clock of their own cannot use."""
    if not issubclass(cls, Sensor):
        return set()
    arm = set() if "lever_arm_b_m" in {field.name for field in dataclasses.fields(cls)} else {"lever_arm_sd_m"}
    return arm | ({"time_offset_s", "time_offset_sd_s"} if cls.from_drive else set())


def _default(field: Any) -> str:
    key, value = field.name, field.default
    if key == "calibrated":
        return f"#{key} = {{}}"
    if value is None:
        # It has no default that could be written: an example, in words.
        return f"# {re.sub(r'_rad(?=_|$)', '_deg', key)} = 0.0"
    if re.search(r"_rad(?=_|$)", key):
        key = re.sub(r"_rad(?=_|$)", "_deg", key)
        value = tuple(map(_degrees, value)) if isinstance(value, tuple) else _degrees(value)
    return f"#{key} = {_text(value)}"


def _degrees(value: float) -> float:
    """As it was written before it became radians."""
    return round(math.degrees(value), 9)


def _text(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    return f"[{', '.join(map(_text, value))}]" if isinstance(value, tuple) else repr(value)


def _wrapped(text: str) -> list[str]:
    return textwrap.wrap(
        text.replace("False", "false").replace("True", "true"), _WIDTH, initial_indent="# ", subsequent_indent="# "
    )


def _parameters(cls: type) -> dict[str, tuple[str, str]]:
    """What the docstrings of a class and its bases say of each parameter: the names it is explained with, and the words."""
    found: dict[str, tuple[str, str]] = {}
    for base in reversed(cls.__mro__):
        section = re.search(r"Parameters\n-+\n(.*?)(?:\n\n|\Z)", inspect.cleandoc(base.__doc__ or ""), re.DOTALL)
        entries = re.split(r"\n(?=\S)", section.group(1)) if section else []
        for entry in entries:
            names, *words = entry.split("\n")
            text = " ".join(word.strip() for word in words).replace("`", "")
            # The file has angles in degrees; rates stay in rad/s.
            text = re.sub(r"_rad(?=_|\b)", "_deg", text.replace("[rad]", "[deg]"))
            found |= {name.strip(): (names, text) for name in names.split(" : ")[0].split(",")}
    documented = {field.name: (field.name, "") for field in dataclasses.fields(cls)}
    return documented | found
