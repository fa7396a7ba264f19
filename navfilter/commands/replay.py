"""``navfilter demo`` and ``navfilter replay``: their arguments and what they do. Everything heavy is imported where it
is used.
"""

from __future__ import annotations

import argparse
import math
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from navfilter.commands import console, mission_part
from navfilter.io.tracks.formats import FORMATS, is_nowhere

if TYPE_CHECKING:
    from navfilter.evaluation.assessment import Assessment, ControlPoint
    from navfilter.models.mission import Mission
    from navfilter.playback.replay import Withheld
    from navfilter.track.track import Track


#: Exit codes of a run whose track is not to be trusted, and of one that nothing in the mission can judge.
NOT_TRUSTED, NOT_JUDGED = 1, 3
#: What every replay writes of a track, for the text of a help.
_FILES = "\n".join(f"  {'track' + form.suffix:15} {form.about}" for form in FORMATS if form.always)


#: What the demonstration compares; the third is the result.
_COMPARED = ("white", "gm1-fitted", "arma", "oracle")


def demo(options: argparse.Namespace) -> int:
    """Simulate a mission of one hour, replay it with a compass error that is learnt on the way, and compare.

    the mission:
      satellite fixes at the surface, dive to 20 m, lawnmower by inertial unit, compass, DVL and depth gauge,
      with outliers and three losses of the DVL (60, 120 and 30 s), surfacing, fixes again.
      The compass errs slowly and swings with a period of 6 s; vehicle.toml believes in a slow error only.

    written to --out:
      report.html, track.*    the run that learns, filtered and smoothed, as from 'navfilter replay'
      comparison/             the same mission with white noise, Gauss-Markov, the learnt model and the true one
      mission.npz, vehicle.toml, vehicle_true.toml

    examples:
      navfilter demo
      navfilter demo --seed 7 --out demo-7        the same mission with other noise
    """
    from navfilter.commands import compare as compare_command

    folder = console.output_folder(options.out, options.force)
    say = console.speaker(options.quiet)
    say("simulating the mission ...")
    from navfilter.simulation.scenarios import simulate_scenario, true_vehicle

    vehicle, mission = simulate_scenario("demo", options.seed, options.duration)
    _check_formats(options, mission)
    truth = true_vehicle("demo", options.duration)
    save(vehicle, mission, folder / "mission.npz", folder / "vehicle.toml", truth)
    errors = None if truth is None else compare_command.true_errors(vehicle, truth)
    plan = compare_command.Plan(_COMPARED, ("compass",), errors, smooth=("arma",))
    tracks = compare_command.replay_models(plan, vehicle, mission, options.quiet)
    code = _write(tracks["arma"], mission, folder, options)
    forward = {name: track.forward or track for name, track in tracks.items()}
    comparison = compare_command.compare_tracks(forward, mission, vehicle, plan.sensors)
    if not options.quiet:
        compare_command.print_comparison(comparison, mission)
    below = console.output_folder(folder / "comparison", options.force)
    compare_command.write_results(comparison, forward, mission, below, options.quiet)
    say(f"Written to {below}{os.sep}: report.html (the models side by side), comparison.csv, summary.json")
    return code


def save(vehicle: Any, mission: Mission, mission_path: Path, vehicle_path: Path, truth: Any = None) -> None:
    """Write a simulated mission and its vehicle; where its sensors err otherwise than it believes, also the vehicle as
    it really is.
    """
    from navfilter.io import write_vehicle

    mission.save(mission_path)
    write_vehicle(vehicle, vehicle_path)
    if truth is not None:
        write_vehicle(truth, vehicle_path.with_name(f"{vehicle_path.stem}_true.toml"))


def replay(options: argparse.Namespace) -> int:
    """Run a recorded mission through the filter (and the smoother).

    MISSION is a folder with a mission.toml, the .toml itself, or a .npz saved by navfilter; --vehicle describes what is
    on board.

    times are those of the mission clock, as in report.html and track.csv; with a plus they count from the recording's
    first reading (+300).
      --withhold gps:300-900            no fix from 300 to 900 s; the track is scored against the fixes withheld
      --withhold gps:300-900,+2000-     and none after 2000 s of the recording
      --withhold gps:all-but-first-120  only those of its first 120 s
      --during dvl:300-360:off          as [[during]] of a mission.toml: no DVL from 300 to 360 s
      --during compass:900-:noise=3     its noise three times as large from then on
      --start latitude_deg=47.1,longitude_deg=8.2,heading_deg=90,heading_sd_deg=2
                                        any of: time_s, latitude_deg, longitude_deg, height_m, roll_deg, pitch_deg,
                                        heading_deg, position_sd_m, velocity_sd_m_s, tilt_sd_deg, heading_sd_deg;
                                        the others stay as they are
      --start align                     not as the mission says, but by an alignment on the first readings

    written to --out:
      report.html     verdict, tables and figures that can be zoomed, one file that works offline (not with --no-report)
      summary.json    errors, consistency (NEES, NIS), counts of every run, every error model that was learnt, and
                      without a truth: surfacings, longest outage, predicted sd, how far the smoothed track lies
                      from the forward one
    <files>
      truth.tum       the truth, where there is one, beside track.tum
      vehicle_learned.toml   where a sensor's error was learnt: your vehicle.toml, comments and units kept, with the
                      models in force at the end put in as 'adopted'; the output says in words what was learnt, the
                      report shows the spectra

    UTC: stamps in seconds since 1970, dates with time, and most logs bring it; else 'epoch' in the mission.toml says at
    what UTC the stamps read zero. track.csv then has a column time_utc, and the other files have dates. Without it they
    have times of the mission clock (KML and GPX none), and --sbet is refused.

    exit codes: 0 the verdict finds nothing, or only what calls for care; 1 the track is not to be trusted (the files
    are written all the same); 2 wrong usage or input; 3 the track is not judged: what drives was not measured, or
    nothing on board corrects it; 130 interrupted. The verdict stands at the end of the output, in summary.json and on
    top of the report.

    examples:
      navfilter replay dive_042 --vehicle vehicle.toml --smooth --out result
      navfilter replay dive_042 --vehicle vehicle.toml --without gps --out no-gps
      navfilter replay dive_042 --vehicle vehicle.toml --withhold gps:all-but-first-120 --out drift  how far it drifts
      navfilter replay dive_042 --vehicle vehicle.toml --smooth --out result --limit mounting=0.1deg --limit scale=0.1%
      navfilter replay dive_042 --vehicle vehicle.toml --smooth --out result --control gates.csv  at surveyed places
      navfilter replay dive_042 --vehicle vehicle.toml --smooth --out result --backward    against an independent run
      navfilter replay dive_042 --vehicle vehicle.toml --iterate 5 --smooth --out best     the best that it gives
      navfilter replay dive_042 --vehicle vehicle.toml --smooth --out result --kml --mcap  for Google Earth and Foxglove
    """
    from navfilter.calibration.lights import check_limits
    from navfilter.calibration.parts import constants_of
    from navfilter.evaluation.assessment import read_control_points
    from navfilter.io import read_vehicle
    from navfilter.playback.instructions import instructed

    if options.passes != 1 and not options.smooth:
        raise ValueError("--passes is of the smoother: give --smooth too.")
    mission = mission_part.with_instructions(options, console.read(options))
    vehicle, mission = instructed(read_vehicle(options.vehicle).without(*options.without), mission)
    mission, withheld = mission_part.select(options, mission, vehicle)
    _check_formats(options, mission)
    if limits := console.limits_of(options):  # a mistake in them shall not cost a replay
        check_limits(limits, constants_of(vehicle))
    control = read_control_points(Path(options.control)) if options.control else ()
    if options.tiles:
        from navfilter.report.instrument import check_tiles

        check_tiles(Path(options.tiles))
    folder = console.output_folder(options.out, options.force)
    if options.iterate:
        vehicle = _identify(vehicle, mission, options.iterate, options.quiet)
    how = {"output_rate_hz": options.output_rate}
    how |= {"passes": options.passes} if options.passes != 1 else {"smooth": options.smooth}
    track = _replayed(vehicle, mission, options.quiet, **how)
    back = _backward(vehicle, mission, track, options) if options.backward else None
    return _write(track, mission, folder, options, withheld, options.vehicle, options.report, limits, control, back)


def _backward(vehicle: Any, mission: Mission, track: Track, options: argparse.Namespace) -> Track:
    """The same mission from its end to its beginning."""
    from navfilter.playback.replay import backward

    console.speaker(options.quiet)("replaying it backward ...")
    return backward(vehicle, mission, track, output_rate_hz=options.output_rate)


def _identify(vehicle: Any, mission: Mission, rounds: int, quiet: bool) -> Any:
    """The vehicle with error models identified on the whole mission; says how the rounds went."""
    from navfilter.playback.replay import SETTLED, identified

    console.compile_first(quiet)
    say = console.speaker(quiet)
    say(f"identifying on {mission.name} ({mission.duration_s / 60:.1f} min) ...")

    def report(number: int, apart: float) -> None:
        change = "first models" if apart == math.inf else f"models changed by {apart:.2g} of their standard deviations"
        say(f"  round {number}: {change}{', settled' if apart < SETTLED else ''}")

    return identified(vehicle, mission, rounds, report=report)


def _replayed(vehicle: Any, mission: Mission, quiet: bool, **how: Any) -> Track:
    from navfilter.calibration.passes import smoothed
    from navfilter.playback.replay import replay as replay_mission

    console.compile_first(quiet, vehicle)
    when = f" from {mission.begin_utc}" if mission.begin_utc else ""
    console.speaker(quiet)(f"replaying {mission.name} ({mission.duration_s / 60:.1f} min{when}) ...")
    run = smoothed if "passes" in how else replay_mission
    return run(vehicle, mission, progress=not quiet and sys.stderr.isatty(), **how)


def _write(
    track: Track,
    mission: Mission,
    folder: Path,
    options: argparse.Namespace,
    withheld: Sequence[Withheld] = (),
    vehicle_file: str | None = None,
    drawn: bool = True,
    limits: Sequence[tuple[str, float, str]] = (),
    control: Sequence[ControlPoint] = (),
    back: Track | None = None,
) -> int:
    """Files, report and tables of one run; the exit code."""
    from navfilter.evaluation.assessment import assess
    from navfilter.io.write import labelled, write_outputs

    tracks = labelled(track)
    assessment = assess(tracks, mission, withheld, limits, control, back)
    remarks = assessment.remarks(mission.name)
    written = write_outputs(tracks, mission, folder, assessment.to_dict(), vehicle_file, remarks, options.formats)
    result = list(tracks.values())[-1]
    written += _write_own_formats(options, result, folder)
    report = folder / "report.html"
    if drawn:
        from navfilter.io.tracks.table import read_track
        from navfilter.io.write import write_text
        from navfilter.report.report import render_report

        others = [read_track(path, result.vehicle) for path in getattr(options, "beside", ())]
        beside = {_unlike(other.label, tracks): other for other in others}
        tiles = getattr(options, "tiles", None)
        with console.figures_bar(options.quiet) as bar:
            write_text(render_report(tracks, mission, bar.update, assessment, beside, tiles), report)
    else:
        report.unlink(missing_ok=True)  # one of an earlier run would speak of another track
    if not options.quiet:
        _print_result(tracks, mission, assessment)
        console.show(f"Written to {folder}{os.sep}:")
        console.show(f"  {'report.html (open this one), ' * drawn}{', '.join(path.name for path in written)}")
    verdict = assessment.verdict
    if verdict.trusted:
        return 0
    where = report if drawn else folder / "summary.json"
    console.complain(f"navfilter: {verdict.headline} See {where}.")
    return NOT_TRUSTED if verdict.wrong else NOT_JUDGED


def _unlike(label: str, tracks: dict[str, Track]) -> str:
    """A label that no run of this replay has."""
    return f"{label} (beside)" if label in tracks or label == "truth" else label


def _print_result(tracks: dict[str, Track], mission: Mission, assessment: Assessment) -> None:
    from navfilter.report.constant_table import lights_text
    from navfilter.report.run_tables import headline_table, sensor_table

    result = list(tracks.values())[-1]
    if mission.truth is not None:
        console.show(f"{headline_table(tracks, mission)}\n")
    console.show(f"{sensor_table(result)}\n")
    for line in assessment.lines():
        console.show(line)
    for learnt in assessment.learnt:
        console.show(f"learnt: {learnt}")
    if assessment.lights:
        console.show(lights_text(assessment.lights))
    console.show(f"\n{assessment.verdict}")
    console.show(f"\n{result.distance_m:.0f} m travelled, {result.cpu_s:.1f} s of processor time.")


# --- further files of the track -------------------------------------------------------------------------------------


def add_formats(parser: argparse.ArgumentParser) -> None:
    """Add an option for each further format of the track, from their one table; list those that are always there."""
    parser.epilog = (parser.epilog or "").replace("<files>", _FILES)
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


def _write_own_formats(options: argparse.Namespace, track: Track, folder: Path) -> list[Path]:
    """The tables of ``--format``."""
    from navfilter.io.tracks.own_columns import read_format, write_own

    return [write_own(track, folder, read_format(path)) for path in options.own_formats]


def _check_formats(options: argparse.Namespace, mission: Mission) -> None:
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
