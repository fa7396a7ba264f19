"""What a filter tells of itself as it runs: propagated, passed, corrected, laid out anew. Those who learn from it
listen to these.
"""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

from navfilter.filter.sensor_channel import Channel
from navfilter.foundation.arrays import Array


class Outcome(NamedTuple):
    """What became of a reading.

    Attributes
    ----------
    status : str
        "used", "rejected" (by the gate), "invalid", "duplicate", "late-replayed" (used, in its place in time),
        "too-late", "ahead" (no drive sample for too long), "waiting" (its clock is in doubt: it is taken
        `Sensor.lead_s` later) or "unknown-sensor".
    nis : float
        Normalised innovation squared; NaN when it was not formed.
    dof : int
        Components used in it.
    widened : bool
        The gate had been widened after a long series of rejections.
    """

    status: str
    nis: float = math.nan
    dof: int = 0
    widened: bool = False

    @property
    def accepted(self) -> bool:
        """Whether the reading corrected the state."""
        return self.status in ("used", "late-replayed")


class Correction(NamedTuple):
    """A reading has been taken, or refused.

    Attributes
    ----------
    outcome : Outcome
    time_s : float
        Of the reading [s].
    channel : Channel or None
        Its working memory holds transition, gain and residual of the update; None where the reading did not come so
        far.
    """

    outcome: Outcome
    time_s: float
    channel: Channel | None


class Propagated(NamedTuple):
    """The compound transition of the drive's samples has been folded into the covariance: `transition`, shape (m,
    m).
    """

    transition: Array


class SamplesUsed(NamedTuple):
    """The state has been carried over `samples`: rows of the seconds since the sample before, and the six values."""

    samples: Array


class SamplesReplaced(NamedTuple):
    """Something else has stood in place of what an axis of the drive said, in the last `seconds`."""

    seconds: float


class StateTransformed(NamedTuple):
    """The error state became `M` times what it was; shape (n_after, n_before). `anew`: what it lacks was set anew."""

    M: Array
    anew: bool = False


class UnitDoubted(NamedTuple):
    """A sensor has contradicted the state on end since a time [s]: what drives it may be wrong; `told`: it is.
    `corrects`: see `navfilter.models.sensors.observable.Observable`.
    """

    since_s: float
    corrects: str
    told: bool = False


Event = Correction | Propagated | SamplesUsed | SamplesReplaced | StateTransformed | UnitDoubted
#: One that is told what the filter does.
Listening = Callable[[Event], None]


class Measurement(NamedTuple):
    """A reading as it arrived; `same` when it had the value of the one before, `frozen` when that had not changed for
    suspiciously long.
    """

    name: str
    time_s: float
    value: Array
    sd: Any
    frozen: bool = False
    same: bool = False
