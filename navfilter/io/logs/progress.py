"""The bar that long reading shows."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, TypeVar

Item = TypeVar("Item")
#: Reading that is done sooner shows no bar [s].
_PATIENCE_S = 1.0


def bar(items: Iterable[Item], path: Path, total: int | None, unit: str) -> Iterator[Item]:
    """Pass items on, with a bar on standard error where that is a terminal and reading takes long."""
    from tqdm import tqdm

    yield from tqdm(
        items,
        desc=path.name,
        total=total,
        unit=f" {unit}",
        delay=_PATIENCE_S,
        disable=None,
        leave=False,
        unit_scale=True,
    )


def byte_bar(path: Path, total: int) -> Any:
    """A bar of bytes, to be told of progress with ``update(bytes)`` and closed."""
    from tqdm import tqdm

    return tqdm(desc=path.name, total=total, unit="B", unit_scale=True, delay=_PATIENCE_S, disable=None, leave=False)
