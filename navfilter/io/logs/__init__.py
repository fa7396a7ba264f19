"""Logs: files in which several instruments are recorded together, each under its topic, as tables for a mission.toml.

One short module per format. Its function ``records(path, wanted, tally)`` yields ``(topic, time_s, record)`` in the
order of the file, or many records at once: an array of times and a mapping of arrays. ``wanted`` is told the full name
of a topic and answers whether its records are wanted (see `Wanted`); ``tally``, a Counter, gets what was dropped:
reason -> how often. A record is an object, a mapping or both nested. Where a topic has a short name that is not its
name without ``[0]``, the module's ``short_name(topic)`` gives it. All else (columns, dotted names, notes, the survey)
is done once, for all formats.
"""

from navfilter.io.logs.formats import FORMATS, Format, format_of, log_format
from navfilter.io.logs.survey import Shelf

__all__ = ["FORMATS", "Format", "Shelf", "format_of", "log_format"]
