"""track.mat for MATLAB and Octave (version 5, which both read): a struct ``track``.

``track.time_s``, ``latitude_deg`` ... as in track.csv, ``posix_s`` where UTC is known
(``datetime(track.posix_s, 'ConvertFrom', 'posixtime', 'TimeZone', 'UTC')``), ``covariance`` (n, 9, 9) of position,
velocity and attitude in north, east, down; ``states``, ``states_sd`` (n, k) with ``state_names``, ``state_units``;
``residuals(i).name``, ``time_s``, ``value``, ``sd``, ``nis``, ``dof``, ``outcome`` (index into ``outcomes``, from 1).
"""

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from navfilter.filter.records import OUTCOMES
from navfilter.foundation.atomic_files import replacing_binary
from navfilter.models.mission import Mission
from navfilter.track.track import Track

#: What one variable of the format can hold [bytes].
_MOST_BYTES = 2**31 - 1
#: Of `Residuals`.
_FIELDS = ("time_s", "value", "sd", "nis", "dof", "outcome")


def write(track: Track, path: Path, mission: Mission | None = None) -> None:
    """The track.

    Raises
    ------
    ValueError
        When it is too long for the format.
    """
    from scipy.io import savemat

    content = _content(track)
    readings = [getattr(r, field) for r in track.residuals.values() for field in _FIELDS]
    if (size := sum(np.asarray(cells).nbytes for cells in (*content.values(), *readings))) > _MOST_BYTES:
        raise ValueError(
            f"{path}: a .mat of version 5 holds 2 GiB, this track needs {size / 2**30:.1f}: lower --output-rate, or"
            " take .nc, which MATLAB reads too."
        )
    with replacing_binary(path) as file:
        savemat(file, {"track": content}, long_field_names=True, oned_as="column")


def _content(track: Track) -> dict[str, Any]:
    bare = len(track.state_names)
    frame = track.to_frame()
    # the states have names that are no identifiers there: they follow as a matrix
    columns = [name for name in frame.columns[: len(frame.columns) - 2 * bare] if name != "time_utc"]
    content: dict[str, Any] = {name: frame[name].to_numpy() for name in columns}
    if track.epoch_utc_s is not None:
        content["posix_s"] = track.time_s + track.epoch_utc_s
    return content | {
        "mission": track.mission_name,
        "vehicle": track.vehicle.name,
        "label": track.label,
        "covariance": track.covariance,
        "states": track.states,
        "states_sd": track.states_sd,
        "state_names": _cells(track.state_names),
        "state_units": _cells(track.state_units),
        "outcomes": _cells(OUTCOMES),
        "residuals": _residuals(track),
    }


def _cells(texts: tuple[str, ...]) -> npt.NDArray[np.object_]:
    return np.array([*texts, None], dtype=object)[:-1]


def _residuals(track: Track) -> npt.NDArray[np.void]:
    rows = np.empty(len(track.residuals), dtype=[(field, object) for field in ("name", *_FIELDS)])
    for i, (name, r) in enumerate(track.residuals.items()):
        rows[i] = (name, r.time_s, r.value, r.sd, r.nis, r.dof, r.outcome.astype(float) + 1.0)
    return rows
