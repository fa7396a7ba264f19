"""How a live run is set up."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from navfilter.service.waterlinked import WaterLinked


@dataclass(frozen=True, kw_only=True)
class Service:
    """How a run is set up, beside what decides its output (`Options`).

    Parameters
    ----------
    input : int or (str, int) or None
        File descriptor, or host and port to listen on; None: only the sources.
    sources : tuple of WaterLinked
        Instruments to connect to.
    silent_s : float
        A client without a reading for so long [s] loses its place to one that comes.
    log : Path, optional
        Folder of the log.
    fsync_s : float
        The log is synced so often [s].
    state : Path, optional
        File of the snapshots.
    snapshot_s : float
        One every so many seconds.
    resume : {"strict", "best"}, optional
        Continue from the snapshot and the log, and what to do when they do not fit (see `navfilter.service.resuming`).
    health : Path, optional
        State file for others.
    say : callable
        Takes a line for the operator; must neither wait nor raise.
    """

    input: int | tuple[str, int] | None
    sources: tuple[WaterLinked, ...] = ()
    silent_s: float = 10.0
    log: Path | None = None
    fsync_s: float = 1.0
    state: Path | None = None
    snapshot_s: float = 10.0
    resume: str | None = None
    health: Path | None = None
    say: Callable[[str], None] = lambda text: None
