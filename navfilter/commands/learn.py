"""``navfilter learn``: how the sensors of a vehicle err, from several dives, and the vehicle.toml for the next one."""

import argparse
import math
from pathlib import Path

from navfilter.commands import console

OK, AS_IT_WAS = 0, 1


def gap(text: str) -> float:
    """A positive number, or "inf"."""
    return math.inf if text == "inf" else console.positive(text)


def run(options: argparse.Namespace) -> int:
    """Learn from several dives how the sensors err, into a vehicle.toml for the next dive.

    A dive tells by the fixes that come after its gaps how well the vehicle is described: a filter that believes too
    much of its DVL misses them by more than it says. One fix at the end of each dive suffices. vehicle.toml's numbers
    are the prior: the standard deviations of the quick and the slow errors of each sensor, within a factor of two. Some
    seventy descriptions about it are tried for each sensor, and for all at once. What is written has the mean variances
    of the posterior, so that one dive changes little and four much.

    An example: four dives of an hour, fixes before and after each, a DVL that is described by its data sheet.

      navfilter learn dive_01 dive_02 dive_03 dive_04 --vehicle vehicle.toml --out learnt.toml
      navfilter replay dive_05 --vehicle learnt.toml --smooth --out result
      navfilter learn dive_05 --vehicle learnt.toml --out learnt.toml --force       a fifth: the four others count, too

    The output has a line for each dive:

      dive_01: 1 fix after gaps of up to 3600 s, missed by 31.20 m (believed 9.70 m, NEES 5.2) -> dvl quick x 1.62
      (within 1.80), slow x 1.31 (within 1.95)

    NEES is the squared miss over what was believed of it; 1 is honest. Every number within a factor of two tells
    nothing yet: that was believed beforehand. Dives whose fixes never pause have no gaps: --gap 600 withholds fixes for
    ten minutes at a time, --gap inf all but the first and the last ones.

    written to --out:
      learnt.toml     your vehicle.toml, comments kept, with the errors as learnt, and tables [learnt] from which the
                      next 'navfilter learn' goes on
      learnt.html     the dives, and of each sensor the spectrum as described and as learnt with its band

    exit codes: 0 the dives tell something; 1 they tell nothing, the errors stay as described; 2 wrong usage or input;
    130 interrupted.
    """
    from navfilter.calibration.over_dives import from_table, learn, to_table
    from navfilter.evaluation.over_dives_text import learnt_lines, to_dict
    from navfilter.io import read_vehicle
    from navfilter.io.toml_editing import write_over_dives
    from navfilter.io.vehicle_toml import read_learnt
    from navfilter.io.write import write_json

    out, page = Path(options.out), Path(options.out).with_suffix(".html")
    beside = [page] * options.report + ([Path(options.json)] if options.json else [])
    console.new_files([out, *beside], options.force)
    vehicle, table = read_vehicle(options.vehicle), read_learnt(options.vehicle)
    before = None if table is None else from_table(vehicle, table)
    missions = [console.read(options, path) for path in options.mission]
    console.compile_first(options.quiet, vehicle)
    say = console.speaker(options.quiet)
    if before is not None:
        say(f"going on from {len(before.counted)} dives: {', '.join(name for name, _ in before.counted)}")
    result = learn(missions, vehicle, sensors=options.sensor, gap_s=options.gap, before=before, report=say)
    say("")
    for line in learnt_lines(result):
        say(line)
    copied = write_over_dives(result.vehicle, to_table(result), out, options.vehicle)
    if options.report:
        from navfilter.report.over_dives_page import write_over_dives_page

        write_over_dives_page(result, page)
    if options.json:
        write_json(to_dict(result), options.json)
    say(
        f"{out} written{console.LAID_OUT_ANEW * (not copied)}"
        + (f", and {page} with pictures." if options.report else ".")
    )
    return OK if result.tells else AS_IT_WAS
