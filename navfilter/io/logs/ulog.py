"""PX4 logs (.ulg), read with pyulog. A topic is a uORB topic, with ``[0]``, ``[1]`` where several instruments publish
it.

``log_time`` is the field ``timestamp``: seconds since the autopilot started.
"""

import contextlib
import io
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from pyulog import ULog

from navfilter.io.logs.topic_names import Wanted
from navfilter.models.mission import MissionError


def records(path: Path, wanted: Wanted, tally: Counter[str]) -> Iterator[tuple[str, Any, Any]]:
    """See `navfilter.io.logs`."""
    try:
        # The library prints what is wrong with a file; here it is counted.
        with contextlib.redirect_stdout(io.StringIO()):
            formats = ULog(str(path), parse_header_only=True).message_formats
            log = ULog(str(path), message_name_filter_list=[name for name in formats if wanted.family(name)])
    except Exception as error:  # pyulog raises its own, struct's and numpy's errors on broken files
        reason = (str(error) or type(error).__name__).splitlines()[0].rstrip(".")
        raise MissionError(f"{path} cannot be read as a PX4 log: {reason}.") from None
    if log.file_corruption:
        tally["place where the file is damaged; what could not be read is missing"] += 1
    if log.dropouts:
        lost_s = 1e-3 * sum(dropout.duration for dropout in log.dropouts)
        tally[f"gaps in which the autopilot could not write its log, {lost_s:.3g} s together"] += len(log.dropouts)
    instances = Counter(data.name for data in log.data_list)
    for data in log.data_list:
        topic = f"{data.name}[{data.multi_id}]" if instances[data.name] > 1 else data.name
        if wanted(topic):
            yield topic, 1e-6 * data.data["timestamp"].astype(float), data.data
