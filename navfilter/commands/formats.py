"""Which further files of the track a command writes: an option for each format, from their one table."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from navfilter.io.tracks.formats import FORMATS, is_nowhere

if TYPE_CHECKING:
    from pathlib import Path

    from navfilter.models.mission import Mission
    from navfilter.track.track import Track

#: What every replay writes of a track, for the text of a help.
FILES = "\n".join(f"  {'track' + form.suffix:15} {form.about}" for form in FORMATS if form.always)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    group = parser.add_argument_group(
        "further files of the track, for other programs (in Python: nf.write_track(track, 'dive.kml'))"
    )
    for form in FORMATS:
        if not form.always:
            needs = [f'pip install "navfilter[{form.extra}]"'] * bool(form.extra) + ["needs UTC"] * form.utc
            group.add_argument(
                f"--{form.name}",
                dest="formats",
                action="append_const",
                const=form.name,
                default=[],
                help=f"track{form.suffix}, {form.about}" + (f" ({'; '.join(needs)})" if needs else ""),
            )
    about = "a table of your own: its file name, separators and columns, see 'Files for other programs' in the manual"
    group.add_argument("--format", dest="own_formats", action="append", default=[], metavar="TOML", help=about)


def write_own_formats(options: argparse.Namespace, track: Track, folder: Path) -> list[Path]:
    """The tables of ``--format``."""
    from navfilter.io.tracks.own_columns import read_format, write_own

    return [write_own(track, folder, read_format(path)) for path in options.own_formats]


def check(options: argparse.Namespace, mission: Mission) -> None:
    """Refuse before the run what could not be written after it.

    Raises
    ------
    ValueError
        See `navfilter.io.tracks.formats.TrackFormat.check`.
    """
    for path in options.own_formats:
        from navfilter.io.tracks.own_columns import read_format

        read_format(path)
    start = mission.start
    nowhere = start is not None and is_nowhere(start.latitude_deg, start.longitude_deg)
    for form in FORMATS:
        if form.name in options.formats:
            form.check(mission, nowhere)
