"""navfilter's own mission file: one .npz, written by `Mission.save`."""

import datetime
import json
from pathlib import Path
from typing import Any

from navfilter.io.containers import read_npz
from navfilter.io.trust import UNPACKED_BYTES, Allowance
from navfilter.models.during import During
from navfilter.models.mission import NPZ_FORMAT, TRUTH_COLUMNS, Mission, MissionError, Stream


def read_mission_npz(path: Path, unpacked_bytes: int = UNPACKED_BYTES) -> Mission:
    """Read a file written by `Mission.save`.

    Raises
    ------
    MissionError
        If the file is missing, truncated, or was not written by `Mission.save`.
    """
    if not path.exists():
        raise MissionError(f"{path}: no such file.")
    try:
        arrays = read_npz(path, Allowance(unpacked_bytes))
    except MissionError as error:
        raise MissionError(f"{path}: {error}") from None
    except Exception as error:  # numpy, zipfile and zlib raise many unrelated types on broken files
        reason = str(error).splitlines()[0].rstrip(".") if str(error) else type(error).__name__
        raise MissionError(f"{path} cannot be read: {reason}. It is truncated or no .npz file.") from None
    if "navfilter_mission" not in arrays:
        raise MissionError(
            f"{path} was not written by Mission.save (arrays: {', '.join(arrays) or 'none'}). "
            "Map its arrays to streams with a mission.toml."
        )
    try:
        meta: dict[str, Any] = json.loads(str(arrays["navfilter_mission"]))
        if meta["format"] != NPZ_FORMAT:
            raise MissionError(
                f"{path} has format {meta['format']}, this version reads {NPZ_FORMAT}; update navfilter."
            )
        names = list(meta["columns"])
        streams = {
            name: Stream(arrays[f"time_{k}"], arrays[f"value_{k}"], tuple(meta["columns"][name]), arrays.get(f"sd_{k}"))
            for k, name in enumerate(names)
        }
        truth = Stream(arrays["time_truth"], arrays["value_truth"], TRUTH_COLUMNS) if meta["truth"] else None
        return Mission(
            name=meta["name"],
            streams=streams,
            truth=truth,
            start=None if meta["start"] is None else _start(meta["start"]),
            date=None if meta["date"] is None else datetime.date.fromisoformat(meta["date"]),
            notes=tuple(meta["notes"]),
            windows=tuple((a, b) for a, b in meta["windows"]),
            epoch_utc_s=meta.get("epoch_utc_s"),
            during=tuple(During(**one) for one in meta.get("during", ())),
        )
    except MissionError:
        raise
    except (KeyError, TypeError, ValueError) as error:
        raise MissionError(f"{path} is damaged ({type(error).__name__}: {error}); save the mission again.") from None


def _start(fields: dict[str, Any]) -> Any:
    from navfilter.models.start import Start

    fields = {**fields, "date": None if fields.get("date") is None else datetime.date.fromisoformat(fields["date"])}
    given: dict[str, Any] = {key: tuple(value) if isinstance(value, list) else value for key, value in fields.items()}
    return Start(**given)
