"""The Earth's magnetic field for compasses: declination, its error, and the iron calibration of a magnetometer."""

import datetime
from typing import NamedTuple

import numpy as np

from navfilter.foundation import utc
from navfilter.foundation.arguments import numbers
from navfilter.foundation.arrays import ArrayLike

MODEL_YEARS = (2010, 2015, 2020, 2025)
#: What the declination of a model errs by is the root of the sum of the squares of an angle [deg] and of another one
#: over the horizontal field [deg nT] (Chulliat et al., 2025, "The US/UK World Magnetic Model for 2025-2030", eq. 43;
#: those of 2015 and 2020 differ by 12 %). Far from the poles it is 0.3 to 0.5 deg.
DECLINATION_SD_DEG, DECLINATION_SD_DEG_NT = 0.26, 5417.0
#: Horizontal field [nT] below which that report warns of compasses, and below which it says that they are of no use.
CAUTION_NT, BLACKOUT_NT = 6000.0, 2000.0
#: An angle of which nothing is known has this sd [rad].
ANY_SD = float(np.pi / np.sqrt(3.0))


class North(NamedTuple):
    """Where a compass points.

    Attributes
    ----------
    declination : float
        East positive [rad].
    sd : float
        What the model's declination errs by [rad].
    horizontal_nt : float
        Horizontal field [nT].
    dip : float
        Of the field below the horizon [rad].
    """

    declination: float
    sd: float
    horizontal_nt: float
    dip: float


def declination(latitude_deg: float, longitude_deg: float, height_m: float, date: datetime.date | None) -> float:
    """Magnetic declination [rad], east positive, by the World Magnetic Model of the date's epoch.

    Parameters
    ----------
    latitude_deg, longitude_deg, height_m : float
    date : datetime.date
        2010 to 2029.

    Raises
    ------
    ValueError
        Without a date, or outside the models' years.

    Examples
    --------
    >>> import datetime
    >>> round(float(np.degrees(declination(32.76, 35.02, 0.0, datetime.date(2024, 6, 1)))), 0)
    5.0
    """
    return north(latitude_deg, longitude_deg, height_m, date).declination


def north(latitude_deg: float, longitude_deg: float, height_m: float, date: datetime.date | None) -> North:
    """Where a compass points, and how well that is known; arguments and errors as for `declination`.

    Examples
    --------
    >>> import datetime
    >>> boothia = north(81.0, -96.0, 0.0, datetime.date(2026, 6, 1))
    >>> boothia.horizontal_nt < 6000.0, bool(np.degrees(boothia.sd) > 0.9)
    (True, True)
    """
    if date is None:
        raise ValueError(
            "the declination needs a date: set date in mission.toml or Start(date=...), or give the compass "
            "declination_rad=... (declination_deg in vehicle.toml), or magnetic=False if it reads true heading."
        )
    if not abs(latitude_deg) <= 90.0:
        raise ValueError(f"declination: latitude_deg must lie between -90 and 90, found {latitude_deg!r}.")
    date = utc.day(date, "declination: date")
    year = date.year + (date.timetuple().tm_yday - 1) / 365.25
    if not MODEL_YEARS[0] <= year < MODEL_YEARS[-1] + 5:
        raise ValueError(f"no World Magnetic Model for {date} (2010 to 2029): give the compass its declination_rad.")
    from pygeomag import GeoMag

    model = GeoMag(base_year=max(y for y in MODEL_YEARS if y <= year))
    result = model.calculate(
        glat=latitude_deg, glon=(longitude_deg + 180.0) % 360.0 - 180.0, alt=height_m / 1000.0, time=year
    )
    sd_deg = np.hypot(DECLINATION_SD_DEG, DECLINATION_SD_DEG_NT / max(result.h, 1.0))
    angles = np.radians([result.d, sd_deg, result.i])
    return North(float(angles[0]), min(float(angles[1]), ANY_SD), float(result.h), float(angles[2]))


def believable(date: datetime.date) -> datetime.date:
    """The date itself, or the first day of the last model where none is for its year.

    A computer without a battery says 1970; a compass must not wait for ever for its declination. The field of the last
    model is wrong by about 0.2 degrees for each year in between.

    Examples
    --------
    >>> believable(datetime.date(1970, 1, 1)), believable(datetime.date(2026, 6, 1))
    (datetime.date(2025, 1, 1), datetime.date(2026, 6, 1))
    """
    known = MODEL_YEARS[0] <= date.year < MODEL_YEARS[-1] + 5
    return date if known else datetime.date(MODEL_YEARS[-1], 1, 1)


def calibrate_magnetometer(
    field: ArrayLike, magnitude: float | None = None
) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Hard and soft iron of a magnetometer from readings taken while turning.

    Readings that leave the plane of the turns get the full ellipsoid (soft iron included); readings confined to a
    plane, as on a car or a vehicle that only yaws, get the offsets in that plane and the ratio of its axes.

    Parameters
    ----------
    field : array_like, shape (n, 3)
        Readings in b, any unit; rows with NaN are left out.
    magnitude : float, optional
        Strength that calibrated readings shall have; default the mean strength of the readings about their centre.

    Returns
    -------
    hard_iron : tuple of 3
    soft_iron : tuple of 9
        As `Heading` takes them: ``soft_iron @ (reading - hard_iron)`` lies on a sphere (circle).

    Raises
    ------
    ValueError
        With fewer than 20 readings, or when they do not turn through at least about half a circle.
    """
    m = numbers(field, "field")
    if m.ndim != 2 or m.shape[1] != 3:
        raise ValueError(f"field must be one row (x, y, z) per reading, found shape {m.shape}.")
    m = m[np.isfinite(m).all(axis=1)]
    if len(m) < 20:
        raise ValueError(f"calibration needs at least 20 readings, found {len(m)}.")
    centre = m.mean(axis=0)
    _, spread, axes = np.linalg.svd(m - centre, full_matrices=False)
    if not spread[1] > 0.15 * spread[0]:
        raise ValueError(
            "the readings lie on a short arc: turn the vehicle through at least half a circle for the calibration."
        )
    dims = 3 if spread[2] > 0.25 * spread[0] else 2
    basis = axes[:dims]
    # Coordinates scaled to unit size, so that the fit of the quadric is well conditioned.
    unit = spread[0] / np.sqrt(len(m))
    p = (m - centre) @ basis.T / unit
    columns = [p[:, i] * p[:, j] for i in range(dims) for j in range(i, dims)] + [p[:, i] for i in range(dims)]
    solution, *_ = np.linalg.lstsq(np.column_stack(columns), np.ones(len(p)), rcond=None)
    A, k = np.zeros((dims, dims)), 0
    for i in range(dims):
        for j in range(i, dims):
            A[i, j] = A[j, i] = solution[k] * (1.0 if i == j else 0.5)
            k += 1
    b = solution[k:]
    middle = -0.5 * np.linalg.solve(A, b)
    A = A / (1.0 + middle @ A @ middle)
    value, vector = np.linalg.eigh(A)
    if np.any(value <= 0):
        raise ValueError(
            "the readings do not lie on an ellipsoid: turn through more directions, away from iron that moves along."
        )
    root = vector @ np.diag(np.sqrt(value)) @ vector.T
    soft = np.eye(3)
    size = 1.0 / np.sqrt(value).mean()
    soft = soft - basis.T @ basis + basis.T @ (root * size) @ basis
    hard = centre + unit * (middle @ basis)
    if magnitude is not None:
        soft = soft * (magnitude / np.linalg.norm((m - hard) @ soft.T, axis=1).mean())
    return tuple(hard.tolist()), tuple(soft.ravel().tolist())
