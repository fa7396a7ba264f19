"""Any file with numbers in it, as named columns: text tables, .npy, .npz and .mat, plain or compressed.

`read_table` is the one entry. Every way in which a file can be unreadable ends in a `MissionError` of one line;
whatever was skipped on the way is counted in `Table.notes`.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np

from navfilter.foundation.arrays import AnyArray
from navfilter.foundation.display import counted
from navfilter.io.logs import Shelf
from navfilter.io.table import Table, TableOptions, Where, listing
from navfilter.io.text_tables import before_comment, read_text
from navfilter.io.trust import BROKEN, OPENERS, Place
from navfilter.models.mission import MissionError

#: Columns of a MOOS log.
_ALOG = ("time", "name", "source", "value")
_BINARY = {".npy", ".npz", ".mat"}
#: Logs that cannot be taken for tables.
_LOGS = {".bag", ".db3", ".mcap", ".ulg", ".tlog", ".ad2cp"}


def read_table(file: Path | Place, options: TableOptions | None = None, shelf: Shelf | None = None) -> Table:
    """Read the columns of one file.

    Parameters
    ----------
    file : Path or Place
        .csv/.txt/.dat/... text, optionally .gz, .xz or .bz2; .npy; .npz; .mat (version 5 or 7.3).
    options : TableOptions, optional
    shelf : Shelf, optional
        The logs of the mission that the table is for; without one a log is gone through for this topic alone.

    Returns
    -------
    Table

    Raises
    ------
    MissionError
        If the file is missing, empty, truncated, not what its name says, or lacks the table asked for.
    """
    options = options or TableOptions()
    place = Place.of(file) if isinstance(file, Path) else file
    path = place.path
    if options.topic:
        from navfilter.io.logs import Shelf

        return _chosen_rows((shelf or Shelf(allowance=place.allowance)).table(path, options.topic), options.where)
    if not path.exists():
        raise MissionError(f"{place.shown}: no such file. Check the path and the environment variables in it.")
    if not path.is_file():
        raise MissionError(f"{place.shown} is not a file.")
    if path.stat().st_size == 0:
        raise MissionError(f"{place.shown} is empty (0 bytes).")
    if path.suffix.lower() in _LOGS:
        raise MissionError(
            f'{place.shown} is a log: say which topic = "..." of it ("navfilter check {place.shown}" lists them).'
        )
    if path.suffix.lower() in _BINARY:
        from navfilter.io.containers import read_arrays

        table = _columns_of(place, read_arrays(place), options)
    else:
        if path.suffix.lower() == ".alog" and options.header is None:
            options = options.model_copy(update={"header": _ALOG, "comment": "%", "delimiter": "whitespace"})
        names = tuple(condition for condition in options.where if isinstance(condition.equals, str))
        table = _read_long(place, names, options) if names else read_text(place, _unpack(place), options)
        options = options.model_copy(update={"where": tuple(c for c in options.where if c not in names)})
    if not table.columns or all(column.shape[0] == 0 for column in table.columns.values()):
        raise MissionError(f"{place.shown} holds no rows of data.")
    return _chosen_rows(table, options.where)


def _chosen_rows(table: Table, conditions: tuple[Where, ...]) -> Table:
    """The rows that fulfil all conditions; how many did not is noted."""
    for condition in conditions:
        keep = condition.rows(table)
        notes = table.notes
        if not keep.any():
            raise MissionError(f"{table.path}: no row has {condition.words()}; look at what the column holds.")
        if not keep.all():
            name = Path(table.path).name
            notes += (f"{name}: {int((~keep).sum())} of {keep.size} rows left out by where ({condition.words()})",)
        columns = {key: cells[keep] if cells.shape[0] == keep.size else cells for key, cells in table.columns.items()}
        table = replace(table, columns=columns, notes=notes)
    return table


def _read_long(place: Place, names: tuple[Where, ...], options: TableOptions) -> Table:
    """Of a table that may be long only the head and the lines that hold the texts asked for, then the rows that are
    so.
    """
    from collections import Counter

    from navfilter.io.logs.lines import lines

    texts = [str(condition.equals).encode() for condition in names]
    head = options.skip_lines + 2
    kept, rows, passed = [], 0, 0
    for line in lines(place.path, Counter(), place.allowance):
        # What precedes the rows (header, comments) decides how they are read.
        rows += rows <= head and bool(before_comment(line.decode("utf-8-sig", "replace"), options.comment))
        if rows <= head or all(text in line for text in texts):
            kept.append(line)
        else:
            passed += bool(line)
    table = read_text(place, b"\n".join(kept), options)
    chosen = _chosen_rows(table, names)
    left_out = passed + len(next(iter(table.columns.values()))) - len(next(iter(chosen.columns.values())))
    words = " and ".join(condition.words() for condition in names)
    notes = (f"{place.path.name}: {counted(left_out, 'rows')} left out by where ({words})",) if left_out else ()
    return replace(chosen, notes=table.notes + notes)


def _unpack(place: Place) -> bytes:
    opener = OPENERS.get(place.path.suffix.lower())
    try:
        if opener is None:
            return place.path.read_bytes()
        data = bytearray()
        with opener(place.path) as file:
            while block := file.read(1 << 20):
                place.allowance.take(len(block))
                data += block
        return bytes(data)
    except MissionError as error:
        raise MissionError(f"{place.shown}: {error}") from None
    except (*BROKEN, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise MissionError(
            f"{place.shown} cannot be unpacked: {reason}. It is truncated or not what its name says."
        ) from None


# --- arrays ---------------------------------------------------------------------------------------------------------


def _columns_of(place: Place, arrays: dict[str, AnyArray], options: TableOptions) -> Table:
    if options.table or len(arrays) == 1:
        # The only array of a file needs no name.
        matrix = _pick(place, arrays, options.table or next(iter(arrays)))
        if matrix.dtype.names:
            columns = {name: matrix[name].ravel() for name in matrix.dtype.names}
        else:
            if matrix.ndim == 1:
                matrix = matrix[:, np.newaxis]
            if matrix.ndim != 2:
                raise MissionError(
                    f'{place.shown}: table "{options.table}" has {matrix.ndim} dimensions {matrix.shape}; '
                    f'pick a plane, such as "{options.table}[0]".'
                )
            if options.transpose:
                matrix = matrix.T
            names = options.header if isinstance(options.header, tuple) else ()
            if names and len(names) != matrix.shape[1]:
                raise MissionError(f"{place.shown}: {len(names)} names in header for {matrix.shape[1]} columns.")
            columns = {names[k] if names else str(k): matrix[:, k] for k in range(matrix.shape[1])}
    else:
        columns = {
            name: array.ravel() for name, array in arrays.items() if max(array.shape, default=0) == array.size > 1
        }
        if not columns:
            tables = str({name: array.shape for name, array in arrays.items()}) if place.quoted else ""
            raise MissionError(f"{place.shown} holds several arrays {tables}: name one with table = ...")
    columns = {name: column[options.skip_rows :] for name, column in columns.items()}
    columns = {name: np.ascontiguousarray(column) for name, column in columns.items()}
    return Table(place.shown, columns, quoted=place.quoted)


def _pick(place: Place, arrays: dict[str, AnyArray], reference: str) -> AnyArray:
    name, *planes = reference.replace("]", "").split("[")
    if name not in arrays:
        names = listing("tables", list(arrays), place.quoted)
        raise MissionError(f'{place.shown}: there is no table "{name}" ({names}).')
    array = arrays[name]
    try:
        for plane in planes:
            array = array[int(plane)]
    except (ValueError, IndexError) as error:
        raise MissionError(f'{place.shown}: table = "{reference}" cannot be picked: {error}.') from None
    return np.asarray(array)
