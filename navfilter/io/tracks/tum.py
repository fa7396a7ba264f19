"""track.tum and truth.tum: ``timestamp tx ty tz qx qy qz qw``, for evo and other tools that compare trajectories.

Metres east, north, up in the plane tangent to the ellipsoid at the first position of the track, and the rotation from
the body (forward, right, down) to that plane. Times are those of the mission clock.
"""

from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from navfilter.foundation.arrays import Array
from navfilter.foundation.atomic_files import pieces, replacing
from navfilter.io.geodesy import Origin, local_enu, matrix_from_euler, origin_of, plane_from_n
from navfilter.models.mission import Mission, Stream
from navfilter.track.track import Track


def write(track: Track, path: Path, mission: Mission | None = None) -> None:
    """The track."""
    place = np.column_stack([track.latitude, track.longitude, track.height])
    _write(path, track.time_s, place, track.attitude, origin_of(track))


def write_truth(track: Track, path: Path, truth: Stream) -> bool:
    """The truth during the track; what it does not know of heights and attitudes is taken from the track, so that it
    counts as no error. False where it has no position.
    """
    known = np.isfinite(truth.value[:, :2]).all(axis=1)
    known &= (truth.time_s >= track.time_s[0]) & (truth.time_s <= track.time_s[-1])
    if not known.any():
        return False
    t, value = truth.time_s[known], truth.value[known]
    own = np.column_stack([track.height, np.unwrap(track.attitude, axis=0)])
    for column, from_track in zip((2, 6, 7, 8), own.T, strict=True):
        value[:, column] = np.where(
            np.isfinite(value[:, column]), value[:, column], np.interp(t, track.time_s, from_track)
        )
    _write(path, t, value[:, :3], value[:, 6:9], origin_of(track))
    return True


def _write(path: Path, time_s: Array, place: Array, attitude: Array, origin: Origin) -> None:
    with replacing(path) as file:
        for rows in pieces(len(time_s)):
            C = plane_from_n(place[rows], origin) @ matrix_from_euler(*attitude[rows].T)
            values = [time_s[rows], local_enu(place[rows], origin), Rotation.from_matrix(C).as_quat()]
            np.savetxt(file, np.column_stack(values), fmt=["%.6f", *["%.5f"] * 3, *["%.9f"] * 4])
