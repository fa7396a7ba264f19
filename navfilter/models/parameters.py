"""Parameters: the states of a sensor or drive beside its error model, such as lever arms, scales and clocks."""

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple, SupportsFloat


class Parameter(NamedTuple):
    """A state of a sensor or drive beside its error model.

    Attributes
    ----------
    name : str
        Unique within its sensor.
    sd : float
        Standard deviation at the start, not negative [unit]; 0 for one that is known to be zero.
    unit : str
        As in the names of columns: "m", "m_s", "rad", "rad_per_k"; "1" is a pure number.
    mean : float
        What it is believed to be at the start [unit].
    """

    name: str
    sd: float
    unit: str
    mean: float = 0.0


#: Of some parameters: name, value and standard deviation, as a calibration found them.
Calibrated = tuple[tuple[str, float, float], ...]


def with_calibrated(parameters: Iterable[Parameter], calibrated: Calibrated) -> tuple[Parameter, ...]:
    """The parameters with value and standard deviation of a calibration in the place of zero and the prior's."""
    if not calibrated:
        return tuple(parameters)
    found = {name: (value, sd) for name, value, sd in calibrated}
    return tuple(p._replace(mean=found[p.name][0], sd=found[p.name][1]) if p.name in found else p for p in parameters)


def check_calibrated(owner: str, calibrated: Calibrated, known: Sequence[str]) -> None:
    """Refuse what no calibration can have found.

    Parameters
    ----------
    owner : str
        For the message.
    calibrated : tuple of (str, float, float)
    known : sequence of str
        Constant states that may be calibrated so.

    Raises
    ------
    ValueError
    """
    for name, value, sd in calibrated:
        if name not in known:
            have = ", ".join(known) or "none: it is unsure of no constant but lever arm and clock"
            raise ValueError(
                f'{owner}.calibrated: "{name}" is no constant state of it (these are: {have}). A lever arm and a clock '
                "are calibrated by lever_arm_b_m and time_offset_s; a constant needs its key of an sd above 0."
            )
        if not (math.isfinite(value) and 0.0 <= sd < math.inf):
            raise ValueError(f'{owner}.calibrated: "{name}" must be [value, sd >= 0], found [{value!r}, {sd!r}].')
    if len({name for name, *_ in calibrated}) < len(calibrated):
        raise ValueError(f"{owner}.calibrated names a constant twice.")


def checked(parameters: Iterable[Any], owner: str) -> tuple[Parameter, ...]:
    """The parameters of a kind that may be anybody's."""
    for given in parameters:
        if not (
            isinstance(given, tuple)
            and len(given) in (3, 4)
            and all(isinstance(given[i], str) and given[i] for i in (0, 2))
        ):
            raise ValueError(
                f'{owner}: a parameter is Parameter(name, sd, unit), such as Parameter("offset", 0.3, "m"); found '
                f"{given!r}."
            )
        if not (isinstance(given[1], SupportsFloat) and 0.0 <= float(given[1]) < math.inf):
            raise ValueError(
                f'{owner}: the sd of the parameter "{given[0]}" must be a finite number >= 0, found {given[1]!r}.'
            )
    return tuple(Parameter(*given) for given in parameters)


def hidden_states(name: str, block: Any, unit: str) -> tuple[Parameter, ...]:
    """The further states of a parameter that wanders by a block of several."""
    return tuple(Parameter(f"{name}[{j}]", math.sqrt(block.P0[j, j]), unit) for j in range(1, block.size))


def constant_parameters(parameters: Iterable[Parameter], wandering: Mapping[str, Any]) -> tuple[Parameter, ...]:
    """Those that do not wander."""
    return tuple(p for p in parameters if p.name.partition("[")[0] not in wandering)
