"""A table of depths as loggers and spreadsheets spoil it: no number of it may be wrong without a word."""

from __future__ import annotations

import datetime
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from navfilter.check import check_mission
from navfilter.io import read_mission
from navfilter.models.mission import MissionError

#: 2023-05-01T12:00:00Z; a reading each second.
NOON = 1682942400.0
K = np.arange(120)
DEPTH = 5.0 + 0.1 * K
DATES = 'unit = "iso8601"'


class Told(NamedTuple):
    """What comes of a file.

    Attributes
    ----------
    said : str
        The gravest words: of a refusal, of `check`, or of the reader; empty: none.
    code : int
        Exit code of ``navfilter check``.
    right : bool
        Whether every reading is what the logger measured, or missing, each a second after the one before.
    """

    said: str
    code: int
    right: bool


def numbers(values: Sequence[float], digits: int = 3) -> list[str]:
    """As text."""
    return [f"{value:.{digits}f}" for value in values]


def dated(form: str, begin_s: float = NOON) -> list[str]:
    """Stamps as text."""
    return [datetime.datetime.fromtimestamp(begin_s + k, datetime.UTC).strftime(form) for k in K.tolist()]


def table(times: Sequence[str], depths: Sequence[str] | None = None, delimiter: str = ",") -> str:
    """Three columns under their names."""
    rows = zip(times, depths or numbers(DEPTH), numbers(K, 1), strict=True)
    return "".join(f"{delimiter.join(row)}\n" for row in (("t", "depth", "x"), *rows))


def told(folder: Path, content: str | bytes, clock: str) -> Told:
    """Read it through a mission.toml, and check it."""
    (folder / "log.csv").write_bytes(content if isinstance(content, bytes) else content.encode())
    time = f'{{column = "t"{", " * bool(clock)}{clock}}}'
    (folder / "mission.toml").write_text(f'[streams.depth]\nfile = "log.csv"\ntime = {time}\ndepth = "depth"\n')
    try:
        mission = read_mission(folder)
    except MissionError as error:
        return Told(str(error).replace(f"{folder}/", "").splitlines()[0], 1, False)
    findings = [finding for finding in check_mission(mission) if finding.severity != "info"]
    said = [f.text.removeprefix("the reader notes: ").removesuffix(".") for f in findings] + list(mission.notes)
    depth = mission.streams["depth"]
    there = np.isin(np.round(DEPTH, 3), np.round(depth.value[:, 0], 3)) if len(depth) != K.size else slice(None)
    fitting = DEPTH[there]
    right = fitting.size == len(depth) and bool(
        (np.isnan(depth.value[:, 0]) | np.isclose(depth.value[:, 0], fitting)).all()
        and np.allclose(np.diff(depth.time_s), np.diff(K[there]), atol=2e-3)
        and np.isfinite(depth.value).any()
    )
    return Told(said[0] if said else "", int(any(f.severity == "error" for f in findings)), right)


S, FEW = numbers(K, 1), table(numbers(K, 1))
SOME = [value if k % 5 else "" for k, value in enumerate(numbers(DEPTH))]
QUOTED = "t,depth\n" + "".join(f'"{k},0","{d:.3f}"\n' for k, d in enumerate(DEPTH)).replace(".", ",")
#: What is in the file -> its content, and how its times are mapped.
FILES: dict[str, tuple[str | bytes, str]] = {
    # layout
    "tabs": (table(S, delimiter="\t"), ""),
    "semicolons": (table(S, delimiter=";"), ""),
    "bars": (table(S, delimiter="|"), ""),
    "columns of blanks": (table(S, delimiter="   "), ""),
    "lines that end with CR": (FEW.replace("\n", "\r"), ""),
    "lines that end with CR CR LF": (FEW.replace("\n", "\r\r\n"), ""),
    "byte order mark": (b"\xef\xbb\xbf" + FEW.encode(), ""),
    "UTF-16": (FEW.encode("utf-16"), ""),
    "UTF-16 without its mark": (FEW.encode("utf-16-le"), ""),
    "decimal commas": (table(S, delimiter=";").replace(".", ","), ""),
    "decimal commas between commas": (FEW.replace(".", ","), ""),
    "decimal commas in quotes": (QUOTED, ""),
    "row numbers without a name": ("t,depth\n" + "".join(f"{k},{k},{d:.3f}\n" for k, d in enumerate(DEPTH)), ""),
    "a name with blanks between blanks": ("t depth (m)\n" + "".join(f"{k} {d:.3f}\n" for k, d in enumerate(DEPTH)), ""),
    "a comma at the end of rows": (FEW.replace("\n", ",\n").replace("x,", "x", 1), ""),
    "the names again in the middle": (FEW.replace("60.0,", "t,depth,x\n60.0,", 1), ""),
    "the names again, in another order": (FEW.replace("60.0,", "depth,t,x\n60.0,", 1), ""),
    "a row of units": (FEW.replace("\n", "\ns,m,m\n", 1), ""),
    "sep=; in front": ("sep=;\n" + table(S, delimiter=";"), ""),
    "a line behind the table": (FEW + "END OF FILE\n", ""),
    "a last row cut short": (FEW[:-9], ""),
    "Ctrl-Z at the end": (FEW + "\x1a", ""),
    "zero bytes in the middle": (FEW.replace("\n60.0", "\n\0\0\0\0\n60.0"), ""),
    "a row with a field too many": (FEW.replace("60.0,11.000", "60.0,11.000,7"), ""),
    # cells
    "thousands with a comma": (table(S, [f'"{1e3 * d:,.1f}"' for d in DEPTH]), ""),
    "the unit in each cell": (table(S, [f"{d:.3f} m" for d in DEPTH]), ""),
    "exponents of Fortran": (table(S, [f"{d:.4E}".replace("E", "D") for d in DEPTH]), ""),
    "***** and --- for no reading": (table(S, [x or ("*****", "---")[k % 2] for k, x in enumerate(SOME)]), ""),
    "-999 for no reading": (table(S, [x or "-999.0" for x in SOME]), ""),
    "infinite for no reading": (table(S, [x or "inf" for x in SOME]), ""),
    # times
    "milliseconds since 1970 as seconds": (table(numbers(1e3 * (NOON + K), 0)), ""),
    "nanoseconds since 1970 as seconds": (table([f"{int(NOON) + k}000000000" for k in K]), ""),
    "days of a spreadsheet as seconds": (table(numbers(NOON / 86400 + 25569 + K / 86400, 9)), ""),
    "days since 1970 as seconds": (table(numbers((NOON + K) / 86400, 9)), ""),
    "hhmmss as seconds": (table(dated("%H%M%S")), ""),
    "hhmmss": (table(dated("%H%M%S", NOON + 43140)), DATES),
    "modified Julian date": (table(numbers(NOON / 86400 + 40587 + K / 86400, 9)), 'unit = "day"'),
    "Julian date": (table(numbers(NOON / 86400 + 2440587.5 + K / 86400, 9)), 'unit = "day"'),
    "seconds rounded to seven digits": (table([f"{NOON + k:.6e}" for k in K]), ""),
    "minutes without seconds": (table(dated("%Y-%m-%d %H:%M")), DATES),
    "mm:ss": (table(dated("%M:%S")), DATES),
    "day and month in doubt": (table(dated("%d/%m/%Y %H:%M:%S")), DATES),
    "two orders of day and month": (table([*dated("%d/%m/%Y")[:60], *dated("%m/%d/%Y", NOON + 2e6)[60:]]), DATES),
    "a zone by its name": (table(dated("%Y-%m-%d %H:%M:%S CEST")), DATES),
    "a zone by its number": (table(dated("%Y-%m-%dT%H:%M:%S+0200")), DATES),
    "day of the year": (table(dated("%Y-%jT%H:%M:%S")), DATES),
    "name of the day in front": (table(dated("%a %b %d %H:%M:%S %Y")), DATES),
    "14 digits": (table(dated("%Y%m%d%H%M%S")), DATES),
    "time of day over midnight": (table(dated("%H:%M:%S", NOON + 43140)), DATES),
    "a clock of 12 hours": (table(dated("%I:%M:%S", NOON + 3540)), DATES),
    "weeks of GPS counted 1024 too far": (table(numbers(NOON + 1024 * 604800 + K)), ""),
    "a second run behind the first": (FEW + FEW.split("\n", 1)[1], ""),
    "a clock that is set on the way": (table(numbers(np.where(K < 60, K, NOON + K))), ""),
    "a clock that is set back by an hour": (table(numbers(np.where(K < 60, NOON + K, NOON - 3600 + K))), ""),
    "one wild stamp": (table([*S[:60], "1e9", *S[61:]]), ""),
    "a counter of 16 bits, its end not said": (table(numbers((65500 + K) % 65536, 0)), ""),
    "seconds of the week over its end": (table(numbers((604740 + K) % 604800, 1)), ""),
}  # fmt: skip
