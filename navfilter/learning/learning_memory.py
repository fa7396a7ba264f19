"""What changes while a filter is listened to, and how its beginning is done again."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from navfilter.filter.input_buffer import InputBuffer
from navfilter.filter.model_change import Change
from navfilter.foundation.arrays import Array
from navfilter.learning.series_memory import OpenLoopMemory
from navfilter.learning.static_recorder import RestMemory


@dataclass(frozen=True)
class RerunRequest:
    """How the beginning is done again.

    Attributes
    ----------
    models : tuple of (str, error models)
        In force from the start.
    adopted : int
        How many have been adopted by then.
    """

    models: tuple[tuple[str, Any], ...]
    adopted: int


def relaid(fed_back: Array, M: Array, after: int) -> Array:
    """What was fed back, see `LearningMemory`, with a head of so many states that M makes of those before."""
    before, result = (len(fed_back) - 3) // 2, np.zeros(2 * after + 3)
    result[:after] = M[:after, :before] @ fed_back[:before]
    result[after : after + 9], result[-3:] = fed_back[before : before + 9], fed_back[-3:]
    return result


@dataclass
class LearningMemory:
    """Everything that changes while a filter is listened to.

    Attributes
    ----------
    fed_back : ndarray, shape (2m + 3,)
        Sum of what the corrections fed back, as an open loop would have carried it, see
        `navfilter.kernels.open_loop_residual`.
    listeners : dict of str to ListenerMemory
    rest : RestMemory or None
    beginning : InputBuffer or None
        Inputs since the start, kept until the first models are adopted; None when that is over.
    kept : (int, int)
        How many samples and readings of them there were.
    stage : int
        How many of the early hops are over.
    hopping : bool
        Whether the next one has begun.
    again : RerunRequest or None
        The beginning will be done again so.
    quiet_s : float
        Nothing is learnt before this time [s]: it is the beginning, done again.
    waiting : tuple of Change
        Models that are adopted one a reading: each costs about a millisecond.
    levels : dict of str to tuple of float
        S(0) of the learnt parts of each sensor's axes with which the beginning was done last.
    refused : bool
        Whether what was learnt last predicts fixes, or its readings, worse than what is in force.
    """

    SHARED: ClassVar = ("beginning",)

    fed_back: Array
    listeners: dict[str, OpenLoopMemory]
    rest: RestMemory | None
    beginning: InputBuffer | None
    kept: tuple[int, int]
    stage: int
    hopping: bool
    again: RerunRequest | None
    quiet_s: float
    waiting: tuple[Change, ...]
    levels: dict[str, tuple[float, ...]]
    refused: bool

    def revive(self, names: tuple[str, ...]) -> None:
        """Make the inputs of the beginning, as they were stored, one's own, for a vehicle with these sensors.

        Raises
        ------
        ValueError
            When they are not as many as were kept, or they or what is being learnt from have another form.
        """
        if self.beginning is not None:
            self.beginning = self.beginning.again(names)
        if (self.beginning.count if self.beginning else (0, 0)) != self.kept:
            raise ValueError("memory.learning.beginning has not as many inputs as were kept")
        for name, listener in self.listeners.items():
            hop, axes = listener.hop, len(listener.models)
            if hop is None:
                continue
            fits = isinstance(hop.heard, np.ndarray) and hop.heard.ndim == 2 and axes <= len(hop.heard) <= axes + 1
            left = isinstance(hop.left_out, np.ndarray) and hop.left_out.shape == listener.left_out.shape
            if not (fits and left and hop.heard.dtype == np.float64 and hop.left_out.dtype.kind == "i"):
                raise ValueError(f"what the hop of {name!r} learns from has another form")
