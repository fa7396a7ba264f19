"""Going on where an earlier run left off, from its snapshot and its log, by a stated policy.

"strict" refuses whatever does not fit, with the reason. "best" goes on from the best there is and tells what it left: a
snapshot that is damaged or of another vehicle is put aside and the whole log fed instead; a log that is damaged gives
what can be read; where nothing is left the run starts like a first one. So a restart by a supervisor always ends in
navigation.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from navfilter.service.disk import StateFile
from navfilter.service.log import logged_options
from navfilter.service.session import Options, Session


class Past(NamedTuple):
    """What an earlier run left.

    Parameters
    ----------
    session : Session
        As its snapshot had it, or a new one.
    snapshot : bool
        Whether there was a snapshot.
    offset : int or None
        Byte of the log at which the feeding begins; None where there is nothing to feed.
    """

    session: Session
    snapshot: bool
    offset: int | None


def earlier_run(
    make: Callable[[Options], Session],
    options: Options,
    state: Path | None,
    log: Path | None,
    policy: str | None,
    tell: Callable[[str], None],
) -> Past:
    """Find what an earlier run left.

    Parameters
    ----------
    make : callable
        Makes a session.
    options : Options
        Of the present run; a log is fed with its own.
    state, log : Path, optional
        Files of the snapshot and of the log, as far as they are in use.
    policy : {"strict", "best"}, optional
        None: this is a new run.
    tell : callable
        Takes a sentence about what does not fit.

    Raises
    ------
    ValueError
        When something does not fit and the policy is "strict".
    """
    size = 0 if log is None else log.stat().st_size
    if policy is None:
        return Past(make(options), False, None)
    if state is not None:
        try:
            session = make(options)
            place = _restored(session, state)
            return Past(session, True, _checked_place(place, size, state, policy, tell) if log is not None else None)
        except FileNotFoundError:
            pass
        except Exception as error:  # nobody can say what a damaged file does
            if policy == "strict":
                raise
            tell(f"the snapshot is refused: {error}")
            with contextlib.suppress(OSError):
                if state.is_file():
                    state.replace(state.with_name(state.name + ".refused"))
    if log is None or not size:
        return Past(make(options), False, None)
    try:
        options = logged_options(log)
    except ValueError as error:
        if policy == "strict":
            raise
        tell(f"{error} What can be read is fed with the options of this run")
    return Past(make(options), False, 0)


def _restored(session: Session, state: Path) -> int | None:
    """Bring a session to its snapshot; how much of the log was in it."""
    saved, nav, place = StateFile.read(state)
    session.restore(saved, nav)
    return place


def _checked_place(place: int | None, size: int, state: Path, policy: str, tell: Callable[[str], None]) -> int | None:
    """Where the feeding of a log begins."""
    if place is None or place <= size:
        return place
    if policy == "strict":
        raise ValueError(f"the log is shorter than when the snapshot {state} was taken: it belongs to another run.")
    tell("the log is shorter than when the snapshot was taken: going on from the snapshot, the log lacks readings")
    return None
