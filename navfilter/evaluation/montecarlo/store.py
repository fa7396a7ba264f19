"""The folder of a campaign: one small file per run and model, written whole or not at all, and told apart from other
campaigns.
"""

import hashlib
import io
import json
import os
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from navfilter.foundation.arrays import AnyArray

Record = dict[str, AnyArray]


def fingerprint(settings: Mapping[str, Any]) -> str:
    """Short digest of the settings of a campaign; equal settings, equal digest."""
    return hashlib.sha256(json.dumps(settings, sort_keys=True).encode()).hexdigest()[:16]


def write_whole(path: Path, content: bytes) -> None:
    """Write a file that is there whole or not at all, whatever kills the program."""
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        with open(part, "wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        os.replace(part, path)
    finally:
        part.unlink(missing_ok=True)


class Store:
    """Finished runs of one campaign.

    Parameters
    ----------
    folder : path
        Made when it is not there.
    settings : dict
        Everything that the numbers depend on, but for seed and model; kept in ``campaign.json``.

    Raises
    ------
    ValueError
        When the folder holds the runs of a campaign with other settings: which ones differ.
    """

    def __init__(self, folder: str | Path, settings: Mapping[str, Any]) -> None:
        self.folder = Path(folder)
        self.fingerprint = fingerprint(settings)
        self._runs = self.folder / "runs"
        self._runs.mkdir(parents=True, exist_ok=True)
        plan = self.folder / "campaign.json"
        if plan.exists():
            _compare(plan, settings)
        else:
            write_whole(plan, json.dumps(dict(settings), indent=1).encode())

    def path(self, seed: int, model: str) -> Path:
        """Where the run of this seed and model is kept."""
        return self._runs / model / f"{seed:08d}.npz"

    def save(self, seed: int, model: str, record: Record) -> None:
        """Keep a finished run."""
        path = self.path(seed, model)
        path.parent.mkdir(exist_ok=True)
        buffer = io.BytesIO()
        whole: Any = record | {"fingerprint": np.array(self.fingerprint), "checksum": np.array(_checksum(record))}
        np.savez_compressed(buffer, **whole)
        write_whole(path, buffer.getvalue())

    def load(self, seed: int, model: str) -> Record | None:
        """A finished run, or None when it is not there, damaged, or of other settings: then it has to be run again."""
        try:
            with np.load(self.path(seed, model), allow_pickle=False) as file:
                record = {name: file[name] for name in file.files}
            mark, checksum = str(record.pop("fingerprint")), str(record.pop("checksum"))
        except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
            return None
        return record if mark == self.fingerprint and checksum == _checksum(record) else None


def _checksum(record: Record) -> str:
    digest = hashlib.sha256()
    for name in sorted(record):
        array = np.ascontiguousarray(record[name])
        digest.update(f"{name} {array.dtype.str} {array.shape}".encode())
        digest.update(array.tobytes())
    return digest.hexdigest()


def _compare(plan: Path, settings: Mapping[str, Any]) -> None:
    try:
        there = json.loads(plan.read_text())
        keys = sorted({*there, *settings})
    except (ValueError, TypeError):
        raise ValueError(
            f"{plan} is damaged. Delete the folder {plan.parent}, or choose another one with --out."
        ) from None
    other = [
        f"{key} {there.get(key)!r} there, {settings.get(key)!r} here"
        for key in keys
        if there.get(key) != settings.get(key)
    ]
    if other:
        raise ValueError(
            f"{plan.parent} holds the runs of a campaign with other settings ({'; '.join(other)}). "
            "Choose another folder with --out, or delete that one."
        )
