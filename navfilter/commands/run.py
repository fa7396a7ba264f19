"""``navfilter run``: its arguments, and what they mean. Everything heavy is imported where it is used."""

import argparse
import datetime
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

from navfilter.commands.console import announce_compilation
from navfilter.foundation.quoting import printable


def date(text: str) -> datetime.date:
    """A day as in 2026-05-04."""
    try:
        return datetime.date.fromisoformat(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"must look like 2026-05-04, found '{text}'") from None


def run(options: argparse.Namespace) -> int:
    """Navigate live: readings in, states out, as line-delimited JSON.

    readings, one per line, in SI units and radians; null is a missing component:
      {"sensor": "imu", "time_s": 12.34, "rate_b": [0.0, 0.0, 0.01], "force_b": [0.1, 0.0, -9.8]}
      {"sensor": "compass", "time_s": 12.34, "value": 1.57}
      {"sensor": "gps", "time_s": 12.0, "value": [0.785, -0.07, null], "sd": [2, 2, 5]}
    A vehicle without an inertial unit is driven by "attitude" (roll, pitch, yaw) and "velocity". "sd" is optional: the
    white standard deviation of this one reading. A line that is no reading is counted and told, and never stops the
    run.

    sources: instruments that navfilter itself connects to, and again when they go. A Water Linked DVL:
      --source waterlinked://192.168.194.95             its velocity is the sensor "dvl"; port 16171
      --source 'waterlinked://192.168.194.95?velocity=velocity&position_local=attitude'
                                                        reports velocity, velocity_water, position_local -> sensors
      Stamps are those of this computer [s since 1970], less the time that the instrument says it took; with
      clock=instrument its own. All other readings must come with the same clock. With --source and without --input or
      --listen nothing else is read.

    the start: --start, or a line {"sensor": "start", "latitude_deg": 45.0, "longitude_deg": -4.0, "heading_deg": 90.0},
      or else an alignment on the first seconds (level by the accelerometers, heading by the compass, place by a fix);
      "waiting" events tell what it lacks.

    states, --rate-hz times a second of the readings' clock: time, place, velocity, attitude, standard deviations, age
      of each sensor, what became of its readings. Lines with an "event" tell of everything else.

    the log is a mission folder: 'navfilter replay DIR --vehicle DIR --out result' smooths it, 'navfilter run
      --replay-log DIR' gives the output of the run again, bit for bit. With --log (or --state) a run that was killed
      goes on with --resume as if nothing had happened. When snapshot or log do not fit, --resume=best (the default)
      goes on from the best there is and tells what it left; --resume=strict refuses.

    what is around the navigation never stops it: a reader that is slow or gone, a full disk, a deleted log, a terminal
      that hangs up are told, counted, and tried again.

    supervision: under systemd (Type=notify) READY, STATUS and WATCHDOG are sent; --health-file is one line of JSON for
      anybody else, whose "unix_s" is the time it was written: when that is more than five seconds ago, the run hangs or
      is no more.

    exit codes:
      0  the end was ordered: Ctrl-C, SIGTERM (also while it still compiles or resumes), or the end of the input
      1  the input failed, or ended before its first reading; with --replay-log: the reader of the output has gone
      2  it could not begin: wrong usage, a file or an address that cannot be used, a log that another process is
         writing
     130 Ctrl-C before anything had been opened; anything else, a signal's number included, is no ordered end

    examples:
      driver | navfilter run --vehicle auv.toml --start start.toml | publisher
      navfilter run --vehicle auv.toml --listen tcp://127.0.0.1:4600 --log dive_042 --rate-hz 10
      navfilter run --vehicle auv.toml --listen tcp://127.0.0.1:4600 --log dive_042 --resume
      driver | navfilter run --vehicle auv.toml --input - --source waterlinked://192.168.194.95
      navfilter run --replay-log dive_042 > states.jsonl
    """
    closed = _open_standard_descriptors()
    from navfilter.service.output import Outlet

    # A thread of its own writes to standard error: a pipe that nobody drains, a full disk or a closed terminal must not
    # stop the run.
    operator = Outlet(
        2, longest=256, dropped_line=lambda count: f"navfilter run: {count} messages were dropped\n".encode()
    )

    def say(text: str) -> None:
        if not options.quiet:
            operator.put(f"navfilter run: {printable(text)}\n".encode(), False)

    try:
        if 1 in closed and options.listen is None:
            say("standard output is closed: nobody hears the states")
        return _run(options, say)
    finally:
        operator.close(1.0)


def _open_standard_descriptors() -> list[int]:
    """Those that were closed; what is opened later must not get their numbers, or messages would end up in the log."""
    closed = []
    while (number := os.open(os.devnull, os.O_RDWR)) <= 2:
        closed.append(number)
    os.close(number)
    return closed


def _run(options: argparse.Namespace, say: Callable[[str], None]) -> int:
    from navfilter.io import read_vehicle
    from navfilter.service.loop import Service, replay_log
    from navfilter.service.loop import run as run_loop
    from navfilter.service.session import Options
    from navfilter.service.sources import waterlinked

    _check(options)
    vehicle = read_vehicle(options.vehicle or options.replay_log)
    if options.replay_log is not None:
        announce_compilation(say)
        return replay_log(vehicle, Path(options.replay_log), rate_hz=options.rate_hz, say=say)
    date = options.date or datetime.datetime.now(datetime.UTC).date()
    decides = Options(rate_hz=options.rate_hz or 1.0, align_s=options.align, start=_start(options.start), date=date)
    log = None if options.log is None else Path(options.log)
    _check_replaced(options, log, say)
    state = log / "snapshot" if options.state is None and log is not None else options.state
    service = Service(
        input=_input(options),
        sources=tuple(waterlinked(url, vehicle) for url in options.source),
        silent_s=options.client_timeout,
        log=log,
        fsync_s=options.fsync,
        state=None if state is None else Path(state),
        snapshot_s=options.snapshot_every,
        resume=options.resume,
        health=None if options.health_file is None else Path(options.health_file),
        say=say,
    )
    announce_compilation(say)
    return run_loop(vehicle, decides, service)


def _check(options: argparse.Namespace) -> None:
    if options.vehicle is None and options.replay_log is None:
        raise ValueError("run needs --vehicle (only --replay-log has one in its folder).")
    if options.resume and options.log is None and options.state is None:
        raise ValueError("--resume needs --log or --state: there is nothing to go on from.")
    others = (options.log, options.state, options.start, options.resume, options.source)
    if options.replay_log is not None and any(others):
        raise ValueError("--replay-log feeds a log as it is: leave out --log, --state, --start, --resume and --source.")


def _check_replaced(options: argparse.Namespace, log: Path | None, say: Callable[[str], None]) -> None:
    """What a run writes over and over is no file of somebody's, and none that the same run needs."""
    from navfilter.io.vehicle_toml import vehicle_file
    from navfilter.service.disk import StateFile
    from navfilter.service.log import LOG_FILE, is_own_file
    from navfilter.service.loop import HealthFile

    needed = [vehicle_file(options.vehicle), *filter(None, (options.start, options.input, log))]
    standard = [f"/dev/fd/{number}" for number in range(3)]  # what the shell has made of < and >
    needed += filter(os.path.isfile, standard)
    if log is not None:
        needed += [log / name for name in (LOG_FILE, "mission.toml", "vehicle.toml")]
        needed += _with_part(log / "snapshot") * (options.state is None)
    for flag, given, is_one in (
        ("--state", options.state, StateFile.is_one),
        ("--health-file", options.health_file, HealthFile.is_one),
    ):
        if given is None:
            continue
        if not Path(given).name:
            raise ValueError(f"{flag} {given} is no file. Give another name.")
        path, part = both = _with_part(Path(given))
        for name in both:
            if any(_same(name, other) for other in needed):
                raise ValueError(f"{flag} {name} would be written over, and this run needs it. Give another name.")
        if os.path.lexists(path) and not is_own_file(path):  # a link would be replaced itself: /dev/stdout, say
            raise ValueError(f"{flag} {path} is no file: it would be replaced. Give another name.")
        needed += both
        for path in both:
            if not is_own_file(path) or path.stat().st_size == 0 or is_one(path):
                continue
            if options.resume is None:
                raise ValueError(
                    f"{flag} {path} is another file, and would be written over. Move it away, or give another name."
                )
            if path == part or flag == "--health-file":  # what becomes of a snapshot is the policy's business
                path.replace(path.with_name(f"{path.name}.refused"))
                say(f"{path} was no file of navfilter run: it is {path.name}.refused now")


def _with_part(path: Path) -> list[Path]:
    """A file, and what is written beside it."""
    return [path, path.with_name(f"{path.name}.part")]


def _same(path: Path, other: str | Path) -> bool:
    """Whether two names are those of one file, also before there is one."""
    if os.path.exists(path) and os.path.exists(other):
        return os.path.samefile(path, other)
    return os.path.realpath(path) == os.path.realpath(other)


def _input(options: argparse.Namespace) -> int | tuple[str, int] | None:
    if options.listen is not None:
        from navfilter.service.sources import listen_address

        return listen_address(options.listen, allow_remote=options.allow_remote)
    if options.input is None and options.source:
        return None
    return 0 if options.input in (None, "-") else os.open(options.input, os.O_RDONLY)


def _start(path: str | None) -> dict[str, Any] | None:
    """Fields of the start in a .toml or .json, at its top or in a table [start]."""
    if path is None:
        return None
    import json
    import tomllib

    from navfilter.io.json_lines import start_from
    from navfilter.io.validation import bounded_text

    text = bounded_text(Path(path))
    try:
        data = json.loads(text) if path.endswith(".json") else tomllib.loads(text)
        return start_from(data["start"] if isinstance(data.get("start"), dict) else data)
    except (ValueError, AttributeError) as error:
        raise ValueError(f"{path}: {error}") from None
