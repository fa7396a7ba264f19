"""``navfilter run --replay-log``: the output of an earlier run again."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from navfilter.io.json_lines import Note
from navfilter.models.vehicle import Vehicle
from navfilter.service.kernel_cache import warm
from navfilter.service.log import LOG_FILE, log_items, logged_options
from navfilter.service.output import Outlet
from navfilter.service.session import Session
from navfilter.service.sources import Stopped, StopSignal

__all__ = ["replay_log"]

_STDOUT = 1


def replay_log(vehicle: Vehicle, folder: Path, *, rate_hz: float | None, say: Callable[[str], None]) -> int:
    """Feed a log again: the output of the run that wrote it, bit for bit.

    Parameters
    ----------
    vehicle : Vehicle
    folder : Path
    rate_hz : float, optional
        Another rate of states than that of the run.
    say : callable
        Takes a line for the operator.

    Returns
    -------
    int
        0; 1 when the reader of the output has gone before its end.
    """
    path = folder / LOG_FILE
    options = logged_options(path)
    stop = StopSignal()
    outlet = Outlet(_STDOUT, wait=True)
    try:
        with stop.at_once():
            warm(say, vehicle)
            session, last = Session(vehicle, options, outlet.put), None
            for last in log_items(path, vehicle):
                if rate_hz is not None and isinstance(last, Note) and last.event == "run":
                    last = last._replace(fields={**last.fields, "rate_hz": rate_hz})
                try:
                    session.feed(last)
                except Exception as error:  # as in the run itself
                    say(f"internal-error: {type(error).__name__}: {error}")
                if outlet.gone:
                    return 1
            if not (isinstance(last, Note) and last.event == "stop"):
                session.stop()
            return int(not outlet.close())
    except Stopped:
        outlet.close(0.5)
        return 0
    finally:
        stop.restore()
