"""Lines that are no readings, counted: noise on a line must not fill the disk with notes about it."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from navfilter.io.json_lines import BadLine, Item

__all__ = ["Tally"]


class Tally:
    """Passes items on; gathers bad lines that are not quoted any more until the next reading, or until `due` is called.

    So there is at most one note of each kind between two readings, however much noise there is, and where it stands
    follows from the lines alone. Without readings `due` is to be called once a second.
    """

    def __init__(self) -> None:
        self._counts: dict[str, int] = {}

    def take(self, items: Iterable[Item]) -> Iterator[Item]:
        """The items, with one note for many bad lines."""
        for item in items:
            if isinstance(item, BadLine) and not item.text:
                self._counts[item.kind] = self._counts.get(item.kind, 0) + item.lines
            else:
                yield from self.due()
                yield item

    def due(self) -> list[Item]:
        """What has been gathered."""
        counts, self._counts = self._counts, {}
        return [BadLine.several(kind, count) for kind, count in counts.items()]
