"""A track of an earlier run, read from its track.csv to be shown beside another one."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pandas as pd

from navfilter.models.vehicle import Vehicle
from navfilter.track.track import Track

_AXES = ("north", "east", "down")
_WANTED = ("time_s", "latitude_deg", "longitude_deg", "height_m", "roll_deg", "pitch_deg", "heading_deg")


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

    def columns(names: list[str], otherwise: float = 0.0) -> np.ndarray:
        found = [table[name] if name in table.columns else np.full(len(table), otherwise) for name in names]
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
