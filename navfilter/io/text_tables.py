"""Text tables as named columns, by the rules of CSV: quotes, delimiters, decimal commas, comments, encodings.

What a file of somebody else's logger may hold beside its rows (a comment, zero bytes where the power was lost, a row
that was cut) is taken out and counted; nothing that remains is read otherwise than the file says it.

Any file with numbers in it, as named columns: text tables, .npy, .npz and .mat, plain or compressed.

`read_table` is the one entry. Every way in which a file can be unreadable ends in a `MissionError` of one line;
whatever was skipped on the way is counted in `Table.notes`.
"""

import codecs
import csv
import io
import itertools
import re
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from navfilter.foundation.arrays import AnyArray
from navfilter.foundation.display import counted
from navfilter.io.logs import Shelf
from navfilter.io.table import Table, TableOptions, Where, listing
from navfilter.io.trust import BROKEN, OPENERS, Place
from navfilter.models.mission import MissionError

#: Where lines end other than by themselves (`str.splitlines`), hold nothing, or have spaces around them.
_UNTIDY = [b"\r", b"\x0b", b"\x0c", b"\x1c", b"\x1d", b"\x1e", b"\n\n", b"\n ", b" \n"]
#: Characters in which a header is looked for: a line need not end.
_BEGINNING = 1 << 20
_QUOTED = re.compile(r'"(?:[^"]|"")*"')
#: What fills the end of a file, or a block of it, that was reserved and not written.
_ZEROS = re.compile(rb"\0+")
_MARKS = ((codecs.BOM_UTF8, "utf-8-sig"), (codecs.BOM_UTF16_LE, "utf-16"), (codecs.BOM_UTF16_BE, "utf-16"))
#: Rows that are looked at for the decimal sign.
_LOOKED_AT = 200
_WITH_COMMA = re.compile(r"[-+]?(?:\d+|\d{1,3}(?:\.\d{3})+)?,\d+(?:[eE][-+]?\d+)?")
_WITH_POINT = re.compile(r"[-+]?\d*\.\d+(?:[eE][-+]?\d+)?")
_LINE_WITH_COMMA = re.compile(rb"^[^\n,]*,[^\n]*", re.MULTILINE)
_THOUSANDS = re.compile(r"[-+]?\d{1,3}(?:,\d{3})+")
#: Rows with fewer fields than the header are cut ones where they are so few; else the logger leaves out empty ones.
_CUT = 0.01
#: No line is longer [bytes], and no table has more columns: a picture as text, a glider's table ten times over. Beyond
#: them a small compressed file takes any room and time.
_LONGEST, _WIDEST = 4 << 20, 20_000


def read_text(place: Place, data: bytes, options: TableOptions) -> Table:
    """Read the columns of a text table.

    Parameters
    ----------
    place : Place
        Where the data are from, for messages.
    data : bytes
    options : TableOptions

    Raises
    ------
    MissionError
        If it is no text, has no rows, or cannot be taken apart.
    """
    import pandas as pd

    notes: list[str] = []
    text = _tidy(_text(place, data, notes), options)
    _check_lines(place, text)
    rows = io.BytesIO(text)
    delimiter, first = options.delimiter, _record(rows)
    if first.lower().startswith("sep=") and len(first) == 5:
        delimiter = delimiter or first[4]
        rows = io.BytesIO(rows.read())
        first = _record(rows)
    delimiter = delimiter or delimiter_of(first, options.decimal, _peek(rows))
    names, has_header = _names(first, _peek(rows), delimiter, options)
    if len(names) > _WIDEST:
        raise MissionError(f"{place.shown} has {len(names)} columns: no table has more than {_WIDEST}.")
    if not has_header:
        rows.seek(0)
    for _ in range(options.skip_rows):
        rows.readline()
    begin = rows.tell()
    first = _peek(rows)
    if not first:
        raise MissionError(f"{place.shown} holds no rows of data.")
    if options.comment and options.comment.encode() in text:
        rows, begin = io.BytesIO(_without_comments(rows, delimiter, len(names), options.comment)), 0
    names, bare = _unique(names), len(names)
    width = max(bare, len(fields_of(first, delimiter)))
    names += [f"unnamed {k}" for k in range(bare, width)]
    decimal, thousands = (options.decimal, None) if options.decimal else _decimal(rows, delimiter)
    try:
        with warnings.catch_warnings(record=True) as told:
            warnings.simplefilter("always")
            frame = pd.read_csv(
                rows,
                sep=r"\s+" if delimiter == "whitespace" else delimiter,
                header=None,
                names=names,
                index_col=False,
                decimal=decimal,
                thousands=thousands,
                skipinitialspace=True,
                on_bad_lines="warn",
                low_memory=False,
            )
    except Exception as error:  # pandas raises half a dozen unrelated types on garbage
        reason = str(error).splitlines()[0] if str(error) and place.quoted else type(error).__name__
        raise MissionError(f"{place.shown} cannot be read as a table: {reason}.") from None
    if skipped := sum(str(warning.message).count("Skipping line") for warning in told):
        if skipped > 1 + _CUT * len(frame):
            raise MissionError(
                f"{place.shown}: {skipped} of {skipped + len(frame)} rows have more fields than the first, {width}. "
                "Two tables behind one another, or two delimiters? Take them apart, or write the names: header = [..]."
            )
        notes.append(counted(skipped, "rows with too many fields skipped"))
    if cut := _cut_rows(frame, rows, begin, delimiter, bare):
        frame = frame.drop(index=cut)
        notes.append(counted(len(cut), "rows with fewer fields than columns left out: cut short"))
    if has_header:
        frame = _without_names(place, frame, names[:bare], notes)
    if decimal == ",":
        # pandas leaves a column alone in which a cell is text
        for name in _texts(frame, names):
            frame[name] = frame[name].map(lambda cell: _pointed(cell) if isinstance(cell, str) else cell)
    columns = {name: frame[name].to_numpy() for name in names}
    while columns and list(columns)[-1].startswith("unnamed ") and all(map(_is_blank, list(columns.values())[-1])):
        columns.popitem()
    found = len(fields_of(first, delimiter))
    blanks_in_names = delimiter == "whitespace" and found < bare and all(map(_is_blank, columns[names[-1]]))
    if has_header and (blanks_in_names or len(columns) > bare):
        raise MissionError(
            f"{place.shown}: the header has {bare} names, the rows have {found} fields: which belong together cannot "
            "be told (decimal commas between commas, row numbers without a name, names with blanks?). Write the names: "
            "header = [..] with skip_lines = 1, or delimiter and decimal."
        )
    file = Path(place.shown).name
    return Table(place.shown, columns, tuple(f"{file}: {note}" for note in notes), quoted=place.quoted)


# --- bytes and lines ------------------------------------------------------------------------------------------------


def _text(place: Place, data: bytes, notes: list[str]) -> bytes:
    """The text as UTF-8 or ASCII, without byte order mark and without zero bytes."""
    if mark := marked_encoding(data):
        data = data.decode(mark, errors="replace").encode()
    elif not data.isascii():
        try:
            data.decode()
        except UnicodeDecodeError:  # of an older system of the West: a degree sign is one byte
            data = data.decode("cp1252", errors="replace").encode()
    data = data.replace(codecs.BOM_UTF8, b"")  # also in the middle, where files were joined
    if b"\0" not in data:
        return data
    # each run ends a row: what follows was written after the next start
    kept = _ZEROS.sub(b"\n", data)
    control = sum(byte < 32 and byte not in b"\t\n\r\x0b\x0c\x1a\x1c\x1d\x1e" for byte in kept[:65536])
    runs = len(_ZEROS.findall(data))
    if control or not kept.strip() or runs > 1 + kept.count(b"\n") // 20:
        raise MissionError(f"{place.shown} is not a text file (it contains zero bytes).")
    what = "zero bytes left out: reserved and never written, as when the power is lost"
    notes.append(counted(data.count(0), what))
    return kept


def _check_lines(place: Place, text: bytes) -> None:
    at = 0
    while len(text) - at > _LONGEST:
        end = text.rfind(b"\n", at, at + _LONGEST + 1)
        if end < 0:
            raise MissionError(f"{place.shown} is no table: it has a line of more than {_LONGEST >> 20} MiB.")
        at = end + 1


def marked_encoding(data: bytes) -> str:
    """The encoding that a byte order mark tells; empty where there is none."""
    return next((encoding for mark, encoding in _MARKS if data.startswith(mark)), "")


def _tidy(data: bytes, options: TableOptions) -> bytes:
    """The lines that hold something, without lines of comment and spaces around them.

    Most logs are so from the start. A line as an object of its own takes twice its text, a day's log ten gigabytes.
    """
    plain = data.replace(b"\r\n", b"\n") if b"\r" in data else data
    comment = options.comment.encode()
    lines_of_comment = comment and (plain.startswith(comment) or b"\n" + comment in plain)
    edges = plain[:1] in (b" ", b"\n") or plain.endswith(b" ")
    if (
        not (options.skip_lines or edges or lines_of_comment)
        and plain.isascii()
        and not any(mark in plain for mark in _UNTIDY)
    ):
        return plain
    lines = (line.strip(" \r\n") for line in data.decode(errors="replace").splitlines()[options.skip_lines :])
    kept = (line for line in lines if line and not (comment and line.startswith(options.comment)))
    return "\n".join(kept).encode()


def _record(rows: io.BytesIO) -> str:
    """The next record: a line, or several where quotes hold the ends of lines."""
    text = rows.readline().decode(errors="replace")
    while text.count('"') % 2 and (more := rows.readline().decode(errors="replace")):
        text += more
    return text.rstrip("\n")


def _peek(rows: io.BytesIO) -> str:
    at = rows.tell()
    text = _record(rows)
    rows.seek(at)
    return text


def before_comment(line: str, comment: str) -> str:
    """What of a line counts as long as nothing is known of its columns: nothing of a line of comment."""
    line = line.strip(" \r\n")
    return "" if comment and line.startswith(comment) else line


def _without_comments(rows: io.BytesIO, delimiter: str, width: int, comment: str) -> bytes:
    """The rows without a comment at their ends. The sign also stands in names (``DVL#1``): it begins a comment only
    behind a row that is whole, and there with blanks on both sides or behind a number.
    """
    kept = []
    for raw in rows:
        line = raw.decode(errors="replace").rstrip("\n")
        at = -1
        while (at := line.find(comment, at + 1)) >= 0:
            before = line[:at]
            cells = fields_of(before, delimiter) if before.count('"') % 2 == 0 else []
            apart = before.endswith(" ") and line[at + len(comment) :][:1] in (" ", "")
            if len(cells) >= width and (apart or _is_number(cells[-1])):
                line = before.rstrip()
                break
        kept.append(line)
    return "\n".join(kept).encode()


def _texts(frame: Any, names: list[str]) -> list[str]:
    """Columns in which a cell is text."""
    return [name for name in names if frame[name].dtype.kind not in "fiub"]


def _without_names(place: Place, frame: Any, names: list[str], notes: list[str]) -> Any:
    """The rows but for those that repeat the names of the columns, as where two files were joined. Other names there
    are refused: what is behind them are other columns.
    """
    texts = _texts(frame, names)
    if len(texts) < len(names) or len(names) < 2:
        return frame
    cells = [frame[column].astype(str).str.strip() for column in texts]
    again = np.logical_and.reduce([one.isin(names).to_numpy() for one in cells])
    for row in np.flatnonzero(again).tolist():
        if (found := [str(one.iloc[row]) for one in cells]) != names:
            shown = f": {', '.join(found)}" if place.quoted else ""
            raise MissionError(
                f"{place.shown}: row {row + 1} has the names of the columns again, in another order{shown}. These are "
                "two tables behind one another: take them apart."
            )
    if again.any():
        notes.append(counted(int(again.sum()), "rows with the names of the columns again left out"))
    return frame[~again]


def _cut_rows(frame: object, rows: io.BytesIO, begin: int, delimiter: str, width: int) -> list[int]:
    """Rows that end before their last column, where they are few: the number at their end may be cut too."""
    import pandas as pd

    assert isinstance(frame, pd.DataFrame)  # pandas is imported where it is used
    if width < 2 or not len(frame):
        return []
    short = set(np.flatnonzero(frame.iloc[:, width - 1].isna().to_numpy()).tolist())
    rows.seek(0, io.SEEK_END)
    last_ends = rows.getbuffer()[-1:] == b"\n"
    lines = rows.getvalue().count(b"\n", begin) + (not last_ends)
    # more lines than rows: a cell holds the end of a line, or a row was skipped
    if not short or len(short) > 1 + _CUT * len(frame) or lines != len(frame):
        return []
    rows.seek(begin)
    return [
        k
        for k, line in enumerate(rows)
        if k in short and len(fields_of(line.decode(errors="replace").rstrip("\n"), delimiter)) < width
    ]


# --- fields ---------------------------------------------------------------------------------------------------------


def fields_of(record: str, delimiter: str) -> list[str]:
    """The fields of a record as CSV has them: a delimiter within quotes is none. Quotes within a field hold no end of a
    line: there the record ends, whatever their number.
    """
    if delimiter == "whitespace":
        record, delimiter = " ".join(record.split("\t")), " "
    csv.field_size_limit(max(csv.field_size_limit(), _LONGEST))
    found = next(csv.reader(io.StringIO(record, newline=""), delimiter=delimiter, skipinitialspace=True), [])
    return found[:-1] if delimiter == " " and found and not found[-1] else found


def _names(first: str, second: str, delimiter: str, options: TableOptions) -> tuple[list[str], bool]:
    """Names of the columns, and whether the first record holds them."""
    fields = fields_of(first, delimiter)
    if isinstance(options.header, tuple):
        return list(options.header), False
    if not (options.header if isinstance(options.header, bool) else not any(map(_is_number, fields))):
        return [str(k) for k in range(len(fields))], False
    if options.comment and (sign := f" {options.comment} ") in first:
        cut = fields_of(first.split(sign, 1)[0].rstrip(), delimiter)
        fields = cut if len(cut) == len(fields_of(second, delimiter)) else fields
    return [name.strip() for name in fields], True


def first_lines(path: Path, most: int = 40) -> list[str]:
    """The first lines of a text file, plain or compressed; none of a broken one, whose reader says what is wrong."""
    try:
        with OPENERS.get(path.suffix.lower(), open)(path, "rb") as file:
            data = file.read(_BEGINNING)
        return data.decode(marked_encoding(data) or "utf-8", errors="replace").splitlines(keepends=True)[:most]
    except BROKEN:
        return []


def delimiter_of(line: str, decimal: str | None = None, after: str = "") -> str:
    """What parts the fields of a line: a tab, a semicolon, a bar or a comma outside of quotes, else blanks; of several
    the one that parts the line behind it into as many.
    """
    bare = _QUOTED.sub("", line)
    there = [candidate for candidate in ("\t", ";", "|", ",") if candidate in bare and candidate != decimal]
    alike = [one for one in there if after and len(fields_of(line, one)) == len(fields_of(after, one))]
    if there:
        return (alike or there)[0]
    return "whitespace" if len(bare.split()) > 1 else ","


def _decimal(rows: io.BytesIO, delimiter: str) -> tuple[str, str | None]:
    """Decimal sign and sign between thousands, as the first rows have them, and the first with a comma: a comma where
    numbers have no point.
    """
    at, cells = rows.tell(), list[str]()
    for _ in range(_LOOKED_AT):
        if not (record := _record(rows)):
            break
        cells += [cell.strip() for cell in fields_of(record, delimiter)]
    later = _LINE_WITH_COMMA.finditer(rows.getvalue(), rows.tell()) if delimiter != "," else iter(())
    rows.seek(at)
    for line in itertools.islice(later, _LOOKED_AT):
        cells += [cell.strip() for cell in fields_of(line[0].decode(errors="replace"), delimiter)]
    with_comma = [cell for cell in cells if _WITH_COMMA.fullmatch(cell)]
    if not with_comma or any(map(_WITH_POINT.fullmatch, cells)) or all(map(_THOUSANDS.fullmatch, with_comma)):
        return ".", None
    return ",", "." if any("." in cell for cell in with_comma) else None


def _pointed(cell: str) -> str:
    """A number with a decimal comma as one with a point; other text as it is."""
    return cell.replace(".", "").replace(",", ".") if _WITH_COMMA.fullmatch(cell.strip()) else cell


def _is_number(field_text: str) -> bool:
    try:
        float(field_text.strip().replace(",", "."))
    except ValueError:
        return False
    return True


def _is_blank(cell: object) -> bool:
    return (isinstance(cell, float) and np.isnan(cell)) or (isinstance(cell, str) and not cell.strip())


def _unique(names: list[str]) -> list[str]:
    seen: dict[str, int] = {}
    result = []
    for position, name in enumerate(names):
        base = name or f"unnamed {position}"
        seen[base] = seen.get(base, 0) + 1
        result.append(base if seen[base] == 1 else f"{base}.{seen[base] - 1}")
    return result


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
