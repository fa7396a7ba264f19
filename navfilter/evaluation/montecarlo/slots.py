"""A mission cut into slots that are scored apart: what holds after ten minutes need not hold after one."""

from itertools import pairwise

import numpy as np

from navfilter.foundation.arrays import Array
from navfilter.track.track import Track, TrackErrors

#: Begin and end of each [s].
Slots = tuple[tuple[float, float], ...]

#: Where slots begin and end [s]. Before the first one the start's tilt settles.
EDGES = (60.0, 120.0, 520.0, 1200.0, 1800.0)
#: After a change of the error so much time [s] is a slot of its own, in which no filter can be honest.
SURPRISED_S = 120.0
#: Of a slot: errors [deg; m horizontal, down], NEES per degree of freedom, shares of errors beyond three predicted
#: standard deviations.
SLOT_SCORES = (
    "heading_rms_deg", "position_rms_m", "down_rms_m",
    "anees_heading", "anees_position", "beyond_heading", "beyond_position",
)  # fmt: skip
#: Which of them are root mean squares.
RMS = np.array(["_rms_" in name for name in SLOT_SCORES])


def slots(duration_s: float, changes_s: float | None = None) -> Slots:
    """The slots of a mission: cut where it ends, and where its error changes.

    Parameters
    ----------
    duration_s : float
    changes_s : float, optional
        When the error changes [s].

    Examples
    --------
    >>> slots(600.0)
    ((60.0, 120.0), (120.0, 520.0), (520.0, 600.0))
    >>> slots(2700.0, 900.0)[2:]
    ((520.0, 900.0), (900.0, 1020.0), (1020.0, 1200.0), (1200.0, 1800.0), (1800.0, 2700.0))
    """
    edges = {*EDGES, *(() if changes_s is None else (changes_s, changes_s + SURPRISED_S))}
    inside = sorted(edge for edge in edges if EDGES[0] <= edge < duration_s)
    return tuple(pairwise([*inside, duration_s])) if inside else ()


def slot_figures(track: Track, errors: TrackErrors, nees: dict[str, Array], cut: Slots) -> Array:
    """Figures of a track in every slot.

    Parameters
    ----------
    track : Track
    errors : TrackErrors
    nees : dict of str to ndarray
        `Track.nees` of these errors.
    cut : Slots

    Returns
    -------
    ndarray, shape (len(cut), len(SLOT_SCORES))
        NaN where the truth is not known. Beyond three sigma are components of the position.
    """
    sd = np.sqrt(np.diagonal(track.covariance, axis1=1, axis2=2))[:, :3]
    with np.errstate(divide="ignore", invalid="ignore"):
        components = np.abs(errors.position_n) / sd
    series = (
        np.degrees(errors.heading) ** 2,
        errors.horizontal**2,
        errors.position_n[:, 2] ** 2,
        nees["heading"],
        nees["position"],
        _beyond(np.sqrt(nees["heading"])),
        _beyond(components),
    )
    result = np.full((len(cut), len(SLOT_SCORES)), np.nan)
    for i, (begin, end) in enumerate(cut):
        rows = (track.time_s >= begin) & (track.time_s < end)
        for k, values in enumerate(series):
            known = values[rows][np.isfinite(values[rows])]
            if known.size:
                result[i, k] = known.mean()
    result[:, RMS] = np.sqrt(result[:, RMS])
    return result


def _beyond(z: Array) -> Array:
    return np.where(np.isfinite(z), z > 3.0, np.nan)
