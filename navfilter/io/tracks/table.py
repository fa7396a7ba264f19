"""track.csv: `Track.to_frame` as text."""

import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from navfilter.foundation import utc
from navfilter.foundation.atomic_files import pieces, replacing_binary
from navfilter.models.mission import Mission
from navfilter.models.vehicle import Vehicle
from navfilter.track.track import Track

#: Decimals; 1e-10 degrees are 0.01 mm. Of any other quantity seven significant figures are more than it has.
_DIGITS = {"time_s": 6, "latitude_deg": 10, "longitude_deg": 10, "height_m": 5, "depth_m": 5}
_FIGURES = -7
_AXES = ("north", "east", "down")
_WANTED = ("time_s", "latitude_deg", "longitude_deg", "height_m", "roll_deg", "pitch_deg", "heading_deg")


def write(track: Track, path: Path, mission: Mission | None = None) -> None:
    """One row per time, degrees and metres, the unit in the name of every column."""
    with replacing_binary(path) as file:
        for rows in pieces(len(track)):
            frame = track.keep(rows).to_frame()
            if rows.start == 0:
                file.write(f"{','.join(frame.columns)}\n".encode())
            marks = None if track.epoch_utc_s is None else utc.text(track.time_s[rows], track.epoch_utc_s)
            frame = frame.drop(columns="time_utc", errors="ignore")
            digits = [_DIGITS.get(name, _FIGURES) for name in frame.columns]
            file.write(text_of_rows(frame.to_numpy(dtype=float), digits, marks))


def text_of_rows(values: NDArray[np.float64], digits: Sequence[int], marks: NDArray[np.str_] | None = None) -> bytes:
    """Rows with commas between the numbers, as Python's ``%`` writes them.

    Parameters
    ----------
    values : ndarray, shape (n, c)
    digits : sequence of int
        Of each column: as ``%.{digits}f``; where negative, as ``%.{-digits}g``.
    marks : ndarray of str, shape (n,), optional
        A further column behind the first.

    Examples
    --------
    >>> text_of_rows(np.array([[0.5, 1.0 / 3.0], [1.0, 2e-9]]), (1, -3))
    b'0.5,0.333\\n1.0,2e-09\\n'
    """
    formats = [f"%.{d}f" if d >= 0 else f"%.{-d}g" for d in digits]
    row = ",".join(formats) + "\n"
    if marks is None:
        return "".join([row % tuple(numbers) for numbers in values.tolist()]).encode()
    row = row.replace(",", ",%s,", 1)
    pairs = zip(values.tolist(), marks.tolist(), strict=True)
    return "".join([row % (numbers[0], mark, *numbers[1:]) for numbers, mark in pairs]).encode()


# --- reading one back ------------------------------------------------------------------------------------------------


def read_track(path: str | os.PathLike[str], vehicle: Vehicle, label: str | None = None) -> Track:
    """Read the track.csv of a run, without its states and residuals.

    Parameters
    ----------
    path : path-like
        The file, or the folder that holds it.
    vehicle : Vehicle
        Stands in the track.
    label : str, optional
        Default: the name of the folder.

    Raises
    ------
    ValueError
        For a file that is no track.csv.
    """
    file = Path(path) / "track.csv" if Path(path).is_dir() else Path(path)
    try:
        table = pd.read_csv(file)
    except (ValueError, UnicodeDecodeError) as error:
        raise ValueError(f"{file} is no track.csv: {error}.") from None
    missing = [name for name in _WANTED if name not in table.columns]
    if missing or not len(table):
        raise ValueError(
            f"{file} is no track.csv of navfilter: it has {'no row' if not missing else f'no {missing[0]}'}."
        )

    def columns(names: list[str]) -> np.ndarray:
        found = [table[name] if name in table.columns else np.zeros(len(table)) for name in names]
        return np.column_stack(found).astype(float)

    sd = columns([f"position_{a}_sd_m" for a in _AXES] + [f"velocity_{a}_sd_m_s" for a in _AXES])
    angles = columns(["roll_sd_deg", "pitch_sd_deg", "heading_sd_deg"])
    covariance = np.zeros((len(table), 9, 9))
    covariance[:, range(9), range(9)] = np.column_stack([sd, np.radians(angles)]) ** 2
    covariance[:, 0, 1] = covariance[:, 1, 0] = columns(["position_north_east_cov_m2"])[:, 0]
    attitude = np.radians(columns(list(_WANTED[4:])))
    return Track(
        label=label or file.resolve().parent.name,
        vehicle=vehicle,
        mission_name="",
        time_s=table["time_s"].to_numpy(float),
        latitude=np.radians(table["latitude_deg"].to_numpy(float)),
        longitude=np.radians(table["longitude_deg"].to_numpy(float)),
        height=table["height_m"].to_numpy(float),
        velocity_n=columns([f"velocity_{a}_m_s" for a in _AXES]),
        attitude=attitude,
        covariance=covariance,
        states=np.empty((len(table), 0)),
        states_sd=np.empty((len(table), 0)),
        state_names=(),
        residuals={},
        error_models={},
    )
