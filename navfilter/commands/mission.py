"""``navfilter mission --init LOG``: say what a log holds, and write the two files that replay it."""

import argparse
from pathlib import Path

from navfilter.commands.console import speaker, unpacked_bytes

OK = 0

#: The kinds of `navfilter.io.logs.draft.LIKE`, stated here so that --help answers at once.


def run(options: argparse.Namespace) -> int:
    """Write a mission.toml and a vehicle.toml for a log (a ROS bag, NMEA, ArduPilot, PX4, PD0, ...) or a table (CSV).

    Lists the topics of the log with their rates, gaps and first values, and maps those of a known kind: what drives,
    what corrects. Both files replay as they are; lines that begin with GUESSED say what was not known for certain.
    Without --init the log is only listed.

    examples:
      navfilter mission --init dive.mcap --out dive              writes dive/mission.toml and dive/vehicle.toml
      navfilter mission --init 2024-05-04.tlog --vehicle-like bluerov2
      navfilter mission --init 'segment_*.dat' --vehicle-like glider --out glider
      navfilter mission dive.mcap                                only lists the topics
    """
    from navfilter.io.logs.draft import draft, survey_of
    from navfilter.io.logs.survey import survey_text

    say = speaker(options.quiet)
    folder = Path(options.out)
    targets = [folder / name for name in ("mission.toml", "vehicle.toml")]
    there = [str(path) for path in targets if path.exists()]
    if options.init and there and not options.force:
        raise ValueError(
            f"{' and '.join(there)}: there already; choose another folder with --out, or --force to replace."
        )
    found = survey_of(Path(options.log), unpacked_bytes(options))
    say(survey_text(found))
    if not options.init:
        return OK
    made = draft(found, folder, options.vehicle_like)
    folder.mkdir(parents=True, exist_ok=True)
    for path, text in zip(targets, (made.mission_toml, made.vehicle_toml), strict=True):
        path.write_text(text, encoding="utf-8", newline="\n")
    streams = ", ".join(f"{name} ({len(stream)})" for name, stream in made.mission.streams.items())
    say(f"\n{targets[0]} and {targets[1]} written: {streams}.")
    if made.guesses:
        say("Guessed, and marked in the files:")
        for guess in made.guesses:
            say(f"  {guess}")
    say(
        "Next:\n"
        f"  navfilter check {folder} --vehicle {folder}\n"
        f"  navfilter replay {folder} --vehicle {folder} --smooth --out result"
    )
    return OK
