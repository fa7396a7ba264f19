"""Height above the bottom: of a DVL, or an altimeter."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from navfilter.foundation.arrays import Array
from navfilter.kernels import measurement
from navfilter.models.error_models import ErrorModel, Errors, GaussMarkov, White, check_numbers
from navfilter.models.parameters import Parameter
from navfilter.models.sensors.observable import Observable
from navfilter.models.sensors.sensor import Sensor, Vector
from navfilter.models.sensors.traits import Columns, Doubt, Example, Plausible
from navfilter.models.start import Start
from navfilter.models.truth import Kinematics, SimulatedReading, Truth

ALTITUDE = Columns("altitude", ("altitude_m",), ("length",))


@dataclass(frozen=True, kw_only=True)
class Altitude(Sensor):
    """Height above the bottom [m], straight down: of a DVL beside its velocities, or of an altimeter.

    Parameters
    ----------
    lever_arm_b_m : (3,) float
        From the reference point to the instrument, in b [m].
    bottom_height_m : float
        Height of the bottom in the height system of the mission [m]; 100 m of water: -100.
    bottom_sd_m : float
        How much the bottom rises and falls around it, as a standard deviation [m]: a state that wanders; 0: it is flat
        and there.
    bottom_tau_s : float
        In what time another bottom comes by [s].
    max_altitude_m : float
        A reading above it is no reading.

    Notes
    -----
    ``reading = height of the instrument - height of the bottom + error``. Over a bottom that nobody knows it says
    little, and does no harm: let `bottom_sd_m` say how little is known.
    """

    error: Errors = White(sd=0.1)
    lever_arm_b_m: Vector = (0.0, 0.0, 0.0)
    bottom_height_m: float = -100.0
    bottom_sd_m: float = 0.0
    bottom_tau_s: float = 60.0
    max_altitude_m: float = 500.0

    kernel: ClassVar[Callable[..., None]] = staticmethod(measurement.altitude)
    confirms_state: ClassVar[bool] = False
    observes: ClassVar[Observable] = Observable.ALTITUDE
    contents: ClassVar[tuple[tuple[Columns, ...], ...]] = ((ALTITUDE,),)
    plausible: ClassVar[Plausible | None] = Plausible(1e-3, 20.0, "cm", most_rate_hz=100.0)
    template: ClassVar[Example | None] = Example(
        "altitude",
        "Height above the bottom, of a DVL or an altimeter, where the height of the bottom is known.",
        4,
        ('error = {model = "white", sd = 0.1}',),
        (0.5, 0.0, 0.1),
        live=False,
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        check_numbers(self, "bottom_sd_m", usual="1 m")
        check_numbers(self, "bottom_tau_s", zero_ok=False, usual="60 s")

    def parameters(self) -> tuple[Parameter, ...]:
        """How much higher the bottom is, or none."""
        return (Parameter("bottom", self.bottom_sd_m, "m"),) if self.bottom_sd_m else ()

    def wandering(self) -> dict[str, ErrorModel]:
        """The bottom."""
        return {"bottom": GaussMarkov(sd=self.bottom_sd_m, tau_s=self.bottom_tau_s)} if self.bottom_sd_m else {}

    def constants(self, start: Start) -> Array:
        """Lever arm and height of the bottom."""
        return np.array([*self.lever_arm_b_m, self.bottom_height_m])

    def read(self, value: Array) -> Array | None:
        """None for zero, which is no echo."""
        return value[:1] if 0.0 < value[0] <= self.max_altitude_m else None

    @property
    def words(self) -> str:
        """What it measures."""
        return "height above the bottom"

    def doubts(self) -> Iterator[Doubt]:
        """Of a bottom above the water."""
        if self.bottom_height_m > 0.0:
            text = f"the bottom is described {self.bottom_height_m:.4g} m above the mission's zero height."
            yield Doubt("bottom_height_m", text, "Heights are positive up: 100 m of water is -100.")

    def simulated(self, here: Kinematics, truth: Truth) -> SimulatedReading:
        """Of the instrument, above a bottom that rises and falls as described."""
        lever_down = here.C_nb[:, 2, :] @ np.asarray(self.lever_arm_b_m, dtype=np.float64)
        bottom = self.bottom_height_m + truth.wandering.get("bottom", np.zeros(len(here.time_s)))
        return (here.height - lever_down - bottom + truth.error[:, 0])[:, None], ALTITUDE.names

    @classmethod
    def examples(cls) -> tuple[Altitude, ...]:
        """Over a bottom that wanders."""
        return (cls(bottom_sd_m=1.0),)
