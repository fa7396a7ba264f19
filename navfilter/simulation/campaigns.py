"""Scenarios for Monte Carlo campaigns: one sensor errs in a known way, its operator believes something simpler.

Every scenario comes on two motions (lawnmower and straight transit) and with two gyros (tactical and micromechanical),
and all of them with three losses of the DVL, outliers of compass, DVL and GPS, fixes at the surface only, and a
surfacing at the end.
"""

import math
from dataclasses import dataclass, replace

from navfilter.models.mission import Mission
from navfilter.models.vehicle import Vehicle
from navfilter.simulation.faults import Changing, Faults, Models
from navfilter.simulation.manoeuvres import Lawnmower
from navfilter.simulation.motion import Motion
from navfilter.simulation.scenarios import dive, survey_vehicle
from navfilter.simulation.simulate import StartErrors, simulate
from navfilter.simulation.studies import BELIEF, HARD, USUAL, Study

__all__ = ["Study"]

MOTIONS = ("lawnmower", "transit")
GYROS = ("tactical", "mems")
#: Readings that a learner looks at before its first model is judged.
WINDOW = 4000

_DEG = math.pi / 180.0
#: The scenarios of campaigns by name.
STUDIES: dict[str, Study] = USUAL | HARD


@dataclass(frozen=True)
class Staged:
    """A scenario made ready: draw as many missions from it as there are seeds.

    Attributes
    ----------
    name : str
        Of the scenario, with motion and gyro.
    study : Study
    vehicle : Vehicle
        As its operator describes it.
    real : Vehicle
        As it is, but for the errors in `faults`.
    motion : Motion
    faults : dict of str to Faults
    truth : dict of str to error models, or None
        What is really the matter with the sensor under study, as near as a model can say it; None where it changes
        during the mission.
    duration_s : float
    """

    name: str
    study: Study
    vehicle: Vehicle
    real: Vehicle
    motion: Motion
    faults: dict[str, Faults]
    truth: dict[str, Models] | None
    duration_s: float

    @property
    def learnt(self) -> str:
        """The correcting sensor that a learner works on: the one under study, or the compass where that is the gyro."""
        return self.study.sensor if self.study.sensor in self.vehicle.sensors else "compass"

    @property
    def window_s(self) -> float:
        """Duration of the learner's first window [s]."""
        return WINDOW / self.vehicle.sensors[self.learnt].rate_hz

    @property
    def oracle(self) -> Vehicle | None:
        """The vehicle whose operator knows the truth; None where it changes during the mission."""
        return None if self.truth is None else self.real.with_error(**self.truth)  # type: ignore[arg-type]

    @property
    def changes_s(self) -> float | None:
        """When the error changes [s]."""
        error = self.faults[self.study.sensor].true_error
        return error.steps[1][0] if isinstance(error, Changing) and len(error.steps) > 1 else None

    def mission(self, seed: int) -> Mission:
        """Simulate the mission of one seed, with its truth."""
        how = {"duration_s": self.duration_s, "faults": self.faults, "start": StartErrors(), "truth_rate_hz": 5.0}
        return simulate(self.real, self.motion, seed=seed, name=f"{self.name}/{seed}", **how)  # type: ignore[arg-type]


def stage(
    name: str,
    *,
    motion: str = "lawnmower",
    gyro: str = "tactical",
    duration_s: float | None = None,
    imu_rate_hz: float = 100.0,
) -> Staged:
    """Make a scenario ready.

    Parameters
    ----------
    name : str
        Key of `STUDIES`; motion and gyro may follow: "compass-gm2/transit/mems".
    motion : "lawnmower" or "transit"
    gyro : "tactical" or "mems"
    duration_s : float, optional
        Default: that of the scenario.
    imu_rate_hz : float
        50 Hz halves the time it takes to simulate a mission; the vehicle described has the same unit.

    Returns
    -------
    Staged

    Raises
    ------
    ValueError
        For unknown names, and rates or durations that are not positive.

    Examples
    --------
    >>> staged = stage("compass-gm2/transit", duration_s=600.0)
    >>> staged.name, staged.study.kind, staged.truth
    ('compass-gm2/transit/tactical', 'smooth', {'compass': GaussMarkov(sd=0.008726646259971648, tau_s=10.0, order=2)})
    """
    key, *more = name.split("/")
    if key not in STUDIES:
        raise ValueError(f'There is no scenario "{key}" for campaigns. Scenarios: {", ".join(STUDIES)}.')
    for word in more:
        motion, gyro = (word, gyro) if word in MOTIONS else (motion, word)
    for value, known, what in ((motion, MOTIONS, "motion"), (gyro, GYROS, "gyro")):
        if value not in known:
            raise ValueError(f'The {what} must be one of {", ".join(known)}, found "{value}".')
    study = STUDIES[key]
    duration = study.duration_s if duration_s is None else float(duration_s)
    if not (duration > 0.0 and imu_rate_hz > 0.0):
        raise ValueError(f"Duration and rate must be positive, found {duration} s and {imu_rate_hz} Hz.")
    plain = survey_vehicle(mems=gyro == "mems")
    drive = replace(plain.drive, rate_hz=float(imu_rate_hz))
    vehicle = study.equip(Vehicle(drive, dict(plain.sensors), plain.name).with_error(compass=BELIEF))
    error = study.error(vehicle, duration)
    faults = _faults(duration, study, error)
    truth = None if isinstance(error, Changing) else {study.sensor: error if study.told is None else study.told}
    course, real = _motion(motion, duration, study), study.really(vehicle)
    return Staged(f"{key}/{motion}/{gyro}", study, vehicle, real, course, faults, truth, duration)


def _motion(name: str, duration_s: float, study: Study) -> Motion:
    """Shallow, with short legs: turns fill a third of the lawnmower."""
    pattern = None if name == "transit" else lambda legs: (Lawnmower(legs, study.leg_m),)
    return dive(duration_s, pattern, (study.fixes_s, 45.0), 10.0, study.rest_s)


def _faults(duration_s: float, study: Study, error: Models | Changing) -> dict[str, Faults]:
    """DVL losses of 30, 60 and 15 s (less in a short mission), outliers, fixes at the surface only.

    Longer losses would leave errors of position that drown those of the heading: 2 minutes on inertia cost 40 m.
    """
    short = min(1.0, duration_s / 1800.0)
    lost = tuple(
        (share * duration_s, share * duration_s + short * long_s)
        for share, long_s in ((0.3, 30.0), (0.5, 60.0), (0.7, 15.0))
    )
    faults = {
        "gps": Faults(available="surface", outlier_probability=0.01, outlier_sd=50.0),
        "dvl": Faults(dropouts=lost, outlier_probability=0.005, outlier_sd=0.5),
        "compass": Faults(outlier_probability=0.002, outlier_sd=20.0 * _DEG),
        "gyro": Faults(),
    }
    sensor = study.sensor
    faults[sensor] = replace(faults.get(sensor, Faults()), true_error=error, **study.faulty)
    return faults
