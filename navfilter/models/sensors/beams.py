"""A DVL beam by beam: bottom and water track of one instrument."""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from navfilter.foundation.arrays import Array
from navfilter.kernels import measurement
from navfilter.models.error_models import ErrorModel, Errors, GaussMarkov, White, check_numbers, per_axis
from navfilter.models.learned_arma import learning_part, resolve_prior
from navfilter.models.navigation_drift import Drift, DriftSource
from navfilter.models.parameters import Parameter
from navfilter.models.sensors.traits import EXAMPLES, Columns, Doubt, Example
from navfilter.models.sensors.velocity import BodyVelocity
from navfilter.models.start import Start
from navfilter.models.truth import Kinematics, SimulatedReading, Truth

MOST_BEAMS = 4
BEAMS = Columns(
    "beams", tuple(f"beam_{i}_m_s" for i in range(1, 5)), ("speed",) * MOST_BEAMS, least=3, independent=True
)
WATER_BEAMS = Columns(
    "water_beams", tuple(f"water_{i}_m_s" for i in range(1, 5)), ("speed",) * MOST_BEAMS, least=3, independent=True
)


@dataclass(frozen=True, kw_only=True)
class DvlBeams(BodyVelocity):
    """The beams of a DVL one by one [m/s]: each is judged for itself, and two of them still help. Bottom track, and
    water track of the same instrument where it has one.

    Parameters
    ----------
    beam_azimuth_rad : tuple of 3 or 4 float
        In which direction each beam looks, clockwise from the instrument's forward axis, seen from above [rad].
    beam_tilt_rad : float
        Angle between a beam and the instrument's down axis [rad].
    water_error : ErrorModel
        Of the beams in water track, where `error` is one model; not learnt.
    current_sd_m_s : float
        Standard deviation of each component of the current [m/s]; 0: no water track.
    current_tau_s : float
        Its correlation time [s].

    Notes
    -----
    A beam reads the velocity of the instrument along it, positive towards the bottom: ``d (1 + s) R(m) y`` with
    ``y`` as for `BodyVelocity` and ``d`` the unit vector of the beam. A reading has four elements (the fourth NaN for
    three beams), or eight with those of the water track, in which ``y`` is the velocity through the water. Lever arm,
    mounting, scale and misalignment are those of the instrument, the same for both. A beam that contradicts the others
    is left out alone while more than half of them remain.
    """

    error: Errors = White(sd=0.01)
    beam_azimuth_rad: tuple[float, ...] = (0.25 * math.pi, 0.75 * math.pi, 1.25 * math.pi, 1.75 * math.pi)
    beam_tilt_rad: float = math.radians(30.0)
    water_error: ErrorModel = White(sd=0.02)
    current_sd_m_s: float = 0.0
    current_tau_s: float = 3600.0

    prior: ClassVar[ErrorModel] = GaussMarkov(sd=0.005, tau_s=5.0) + White(sd=0.01)
    axes: ClassVar[int] = 2 * MOST_BEAMS
    reads: ClassVar[int] = MOST_BEAMS
    axis_names: ClassVar[tuple[str, ...]] = tuple(f"{track}_{i}" for track in ("beam", "water") for i in range(1, 5))
    kernel: ClassVar[Callable[..., None]] = staticmethod(measurement.beam_velocity)
    single_gates: ClassVar[bool] = True
    tracks: ClassVar[int] = 2
    gives: ClassVar[str] = ""
    contents: ClassVar[tuple[tuple[Columns, ...], ...]] = ((BEAMS,),)
    beside: ClassVar[tuple[Columns, ...]] = (WATER_BEAMS,)
    template: ClassVar[Example | None] = EXAMPLES["beams"]

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 3 <= len(self.beam_azimuth_rad) <= MOST_BEAMS or not all(map(math.isfinite, self.beam_azimuth_rad)):
            raise ValueError(
                f"DvlBeams.beam_azimuth_rad must be 3 or 4 finite angles, found {self.beam_azimuth_rad!r}. Usual: "
                "beam_azimuth_deg = [45, 135, 225, 315], or [0, 120, 240]."
            )
        if not 0.0 < self.beam_tilt_rad < 0.5 * math.pi:
            raise ValueError(
                f"DvlBeams.beam_tilt_rad must lie between 0 and pi/2, found {self.beam_tilt_rad!r}. Usual: "
                "beam_tilt_deg = 30, from the instrument's down axis."
            )
        check_numbers(self, "current_sd_m_s", usual="0.3 m/s")
        check_numbers(self, "current_tau_s", zero_ok=False, usual="3600 s")
        if any(learning_part(model) is not None for model in self.models[MOST_BEAMS:]):
            raise ValueError(
                "DvlBeams: the error of the water track cannot be learnt under way, because the current hides in it. "
                "Give water_error (or the last four of error) a fixed model."
            )

    @property
    def models(self) -> tuple[ErrorModel, ...]:
        """Of the four beams over ground, then through water."""
        given = self.error
        if isinstance(given, ErrorModel):
            given = (given,) * MOST_BEAMS + (self.water_error,) * MOST_BEAMS
        return resolve_prior(per_axis(given, self.axes, "DvlBeams.error"), self.prior)

    def parameters(self) -> tuple[Parameter, ...]:
        """Current north and east, then scale and misalignment, where they are uncertain."""
        sd = self.current_sd_m_s
        current = tuple(Parameter(f"current_{axis}", sd, "m_s") for axis in ("north", "east")) if sd else ()
        return current + self.calibration()

    def wandering(self) -> dict[str, ErrorModel]:
        """The current."""
        if not self.current_sd_m_s:
            return {}
        current = GaussMarkov(sd=self.current_sd_m_s, tau_s=self.current_tau_s)
        return {"current_north": current, "current_east": current}

    def beams(self) -> Array:
        """Unit vectors of the beams in instrument axes, shape (4, 3); zeros for a fourth that is not there."""
        azimuth = np.asarray(self.beam_azimuth_rad, dtype=float)
        sine, cosine = math.sin(self.beam_tilt_rad), math.cos(self.beam_tilt_rad)
        beams = np.zeros((MOST_BEAMS, 3))
        beams[: len(azimuth)] = np.column_stack(
            [sine * np.cos(azimuth), sine * np.sin(azimuth), np.full(len(azimuth), cosine)]
        )
        return beams

    def over_ground(self, values: Array) -> Array:
        """Values of the beams over ground, as velocities of the instrument, shape (n, 3); a lost beam says nothing."""
        return np.asarray(np.nan_to_num(values[:, :MOST_BEAMS]) @ np.linalg.pinv(self.beams()).T)

    def constants(self, start: Start) -> Array:
        """Lever arm, mounting matrix, beams, number of the states of the current."""
        current = 2.0 if self.current_sd_m_s else 0.0
        return np.concatenate([super().constants(start), self.beams().ravel(), [current]])

    def read(self, value: Array) -> Array | None:
        """Eight beams, NaN for those that are lost; None when none is left."""
        z = np.full(self.axes, math.nan)
        z[: len(value)] = value[: self.axes]
        z[len(self.beam_azimuth_rad) : MOST_BEAMS] = math.nan
        z[MOST_BEAMS + len(self.beam_azimuth_rad) :] = math.nan
        if not self.current_sd_m_s:
            z[MOST_BEAMS:] = math.nan
        with np.errstate(invalid="ignore"):
            z[~(np.abs(z) <= self.max_speed_m_s)] = math.nan
        for track in (z[:MOST_BEAMS], z[MOST_BEAMS:]):
            if self.zero_is_invalid and not np.any(np.nan_to_num(track)):
                track[:] = math.nan
        return None if np.isnan(z).all() else z

    def instrument_axes(self) -> Array:
        """Directions of the eight beams in the body, shape (8, 3)."""
        return np.vstack([self.beams(), self.beams()]) @ super().instrument_axes()

    def drift(self, drive: DriftSource, axis: int, walk: float) -> Drift:
        """The part of a horizontal and of a vertical velocity that lies along a beam."""
        period_s, sine, cosine = 1.0 / self.rate_hz, math.sin(self.beam_tilt_rad), math.cos(self.beam_tilt_rad)
        level = drive.velocity_drift(walk, period_s).density
        upright = drive.velocity_drift(walk, period_s, vertical=True).density
        density = tuple(math.hypot(sine * h, cosine * v) for h, v in zip(level, upright, strict=True))
        return Drift(density, period_s)

    @property
    def words(self) -> str:
        """What it measures."""
        track = "over ground and through the water" if self.current_sd_m_s else "over ground"
        return f"velocity {track} along {len(self.beam_azimuth_rad)} beams, each judged for itself"

    def stream_columns(self) -> tuple[str, ...]:
        """Four, or eight with water track."""
        return (*BEAMS.names, *WATER_BEAMS.names) if self.current_sd_m_s else BEAMS.names

    def doubts(self) -> Iterator[Doubt]:
        """Also of the beams and of the current."""
        yield from super().doubts()
        tilt_deg = math.degrees(self.beam_tilt_rad)
        if not 10.0 <= tilt_deg <= 45.0:
            cure = "Usual: 20 to 30 deg; write beam_tilt_deg, the angle from the down axis (not from the horizontal)."
            yield Doubt("beam_tilt_rad", f"beams {tilt_deg:.3g} deg from the down axis are unusual.", cure)
        if np.linalg.cond(self.beams()[: len(self.beam_azimuth_rad)]) > 10.0:
            cure = "Azimuths go round the instrument: beam_azimuth_deg = [45, 135, 225, 315]."
            yield Doubt("beam_azimuth_rad", "the beams look into nearly the same directions.", cure)
        if self.current_sd_m_s > 3.0:
            text = f"a current of {self.current_sd_m_s:.4g} m/s is faster than all but the strongest tidal streams."
            yield Doubt("current_sd_m_s", text, "It is in m/s; for cm/s write current_sd_cm_per_s.")

    def simulated(self, here: Kinematics, truth: Truth) -> SimulatedReading:
        """The part of the instrument's velocity along each beam, over ground and through water that moves."""
        from scipy.spatial.transform import Rotation  # only a simulation needs it

        lever = np.asarray(self.lever_arm_b_m, dtype=np.float64)
        mounting = Rotation.from_euler("ZYX", self.mounting_rad[::-1])
        tracks = []
        for current_n in (np.zeros(3), truth.current_n):
            v_b = np.einsum("nij,ni->nj", here.C_nb, here.velocity_n - current_n) + np.cross(here.rate_eb_b, lever)
            tracks.append(truth.turned_and_scaled(mounting.inv().apply(v_b)) @ self.beams().T)
        columns = self.stream_columns()
        return (np.hstack(tracks) + truth.error)[:, : len(columns)], columns

    @classmethod
    def examples(cls) -> "tuple[DvlBeams, ...]":
        """With water track."""
        return (cls(current_sd_m_s=0.3),)
