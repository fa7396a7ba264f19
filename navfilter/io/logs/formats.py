"""The formats of logs: how each is known, and by which module and package it is read."""

import importlib
import importlib.util
import re
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType

from navfilter.io.logs.lines import first_bytes
from navfilter.models.mission import MissionError


@dataclass(frozen=True)
class Format:
    """A format of logs, and how it is known and read.

    Parameters
    ----------
    title : str
        For messages.
    module : str
        Module of this folder.
    suffixes : tuple of str
        Endings of its files, in lower case.
    package, extra : str
        What it is read with, and the extra of navfilter that brings it; empty: nothing beside navfilter.
    pattern : bytes
        Regular expression that the beginning of such a file contains, for files of any other ending.
    """

    title: str
    module: str
    suffixes: tuple[str, ...]
    package: str = ""
    extra: str = ""
    pattern: bytes = b""

    def load(self) -> ModuleType:
        """The module that reads it. Raises MissionError where what it needs is not installed."""
        if self.package and importlib.util.find_spec(self.package) is None:
            raise MissionError(
                f"{self.title} is read with {self.package}, which is not installed:"
                f' pip install "navfilter[{self.extra}]"'
            )
        return importlib.import_module(f"navfilter.io.logs.{self.module}")


FORMATS: tuple[Format, ...] = (
    Format("a ROS bag", "ros", (".bag", ".db3", ".mcap"), "rosbags", "ros"),
    Format("a Teledyne PD0 log", "pd0", (".pd0",), pattern=rb"\A[^\x7f]{0,64}\x7f\x7f[\x00-\xff]{2}\x00[\x02-\x20]"),
    Format("an ArduPilot log", "ardupilot", (".bin", ".tlog"), "pymavlink", "ardupilot"),
    Format("a Nortek log", "nortek", (".ad2cp",)),
    Format("a Slocum glider's table", "slocum", (), pattern=rb"\Adbd_label:"),
    Format("an Expedition log", "expedition", (), pattern=rb"\A!Boat,Utc,"),
    Format("a Water Linked log", "waterlinked", (), pattern=rb'"format": ?"json_v'),
    Format("a PX4 log", "ulog", (".ulg",), "pyulog", "px4"),
    Format("a MOOS log", "moos", (".alog",)),
    Format(
        "NMEA 0183", "nmea", (".nmea",), "pynmeagps", "nmea", rb"[$!][A-Z]{2}[A-Z0-9]{3,6},[^*\r\n]*\*[0-9A-Fa-f]{2}"
    ),
)


def format_of(path: Path) -> Format | None:
    """The format of a log; None for what is no log (or a table that `read_table` reads)."""
    if path.is_dir():
        return FORMATS[0] if (path / "metadata.yaml").exists() else None
    for known in FORMATS:
        if any(ending.lower() in known.suffixes for ending in path.suffixes[-2:]):
            return known
    head = first_bytes(path)
    return next((known for known in FORMATS if known.pattern and re.search(known.pattern, head)), None)


def log_format(path: Path) -> Format:
    """The format of a log. Raises MissionError for what is none."""
    known = format_of(path)
    if known is None:
        endings = ", ".join(f"{one.title} ({', '.join(one.suffixes) or 'any ending'})" for one in FORMATS)
        raise MissionError(f"{path} is no log that navfilter knows (known: {endings}); leave topic out for a table.")
    return known
