"""An error, or a current, that swings with a period: tides, waves, schuler-like swings."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from navfilter.models.error_models import Block, ErrorModel, checked_number


@dataclass(frozen=True)
class Cycle(ErrorModel):
    """Stationary swing of known period, whose amplitude and phase wander (Harvey, 1989, sec. 2.3.4: stochastic cycle).

    Parameters
    ----------
    sd : float
        Stationary standard deviation [unit]; a steady swing of amplitude a has ``a / sqrt(2)``.
    period_s : float
        Of the swing [s]; a semidiurnal tide 44714, a diurnal one 89428.
    tau_s : float
        Time in which amplitude and phase become others [s].

    Notes
    -----
    Autocovariance ``sd^2 exp(-t / tau) cos(2 pi t / period)``. Two states: the swing, and what it is a quarter of a
    period later; both turn into each other.

    Examples
    --------
    >>> block = Cycle(sd=0.2, period_s=40.0, tau_s=1e6).block(period_s=10.0)
    >>> [round(float(x), 3) for x in block.Phi[0]]
    [0.0, 1.0]
    """

    sd: float
    period_s: float
    tau_s: float

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("sd", "period_s", "tau_s"):
            checked_number(f"Cycle.{name}", getattr(self, name), zero_ok=name == "sd")

    def block(self, period_s: float) -> Block:
        """Discretise: exact for any period."""
        angle, keep = 2.0 * math.pi * period_s / self.period_s, math.exp(-period_s / self.tau_s)
        turn = np.array([[math.cos(angle), math.sin(angle)], [-math.sin(angle), math.cos(angle)]])
        gained = -math.expm1(-2.0 * period_s / self.tau_s) * self.sd**2
        return Block(keep * turn, gained * np.eye(2), np.array([1.0, 0.0]), 0.0, self.sd**2 * np.eye(2))
