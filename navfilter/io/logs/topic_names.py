"""Which topics of a log are wanted: by their full names, their short names, or by a pattern."""

import fnmatch
from collections.abc import Callable, Collection

from navfilter.io.trust import Allowance

#: Midnight of a day that the log does not name; the clock of an instrument, which need not be UTC.
OF_DAY, INSTRUMENT = "of day", "instrument"


def without_instance(topic: str) -> str:
    """``"IMU"`` for ``"IMU[0]"``."""
    return topic.split("[", 1)[0]


class Wanted:
    """Told the full name of a topic, whether it is wanted; remembers which topics there are.

    Parameters
    ----------
    names : collection of str, optional
        The topics asked for: full names, short ones, or patterns with ``*``. None: all.
    short : callable
        Short name of a topic, in the format of the log.
    allowance : Allowance, optional
        What the log may unpack to.
    """

    def __init__(
        self,
        names: Collection[str] | None = None,
        short: Callable[[str], str] = without_instance,
        allowance: Allowance | None = None,
    ) -> None:
        self._names = names
        self.allowance = allowance or Allowance()
        self.short = short
        self._answers: dict[str, tuple[str, ...]] = {}
        #: Topic -> field -> unit, where the log itself says so; filled by the reader.
        self.units: dict[str, dict[str, str]] = {}
        #: What the times count by, where that is not UTC: `OF_DAY` or `INSTRUMENT`; set by the reader.
        self.clock = ""

    def __call__(self, topic: str) -> bool:
        return bool(self.asked_as(topic))

    def asked_as(self, topic: str) -> tuple[str, ...]:
        """The names asked for that a topic answers to; itself where all are wanted."""
        if topic not in self._answers:
            self._answers[topic] = (topic,) if self._names is None else self._matching(topic, self._names)
        return self._answers[topic]

    def family(self, name: str) -> bool:
        """Whether an instance of this topic may be wanted; for formats that do not know beforehand which there are."""
        return self._names is None or any("*" in asked or without_instance(asked) == name for asked in self._names)

    @property
    def seen(self) -> tuple[str, ...]:
        """All topics asked about, in the order of their appearance."""
        return tuple(self._answers)

    def _matching(self, topic: str, names: Collection[str]) -> tuple[str, ...]:
        short = self.short(topic)
        return tuple(
            name for name in names if name in (topic, short) or ("*" in name and fnmatch.fnmatchcase(topic, name))
        )
