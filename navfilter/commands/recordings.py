"""``navfilter replay A B C``: many recordings side by side in processes, each into a folder of its own."""

import argparse
import contextlib
import io
import json
import math
from collections.abc import Callable
from concurrent.futures import as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from navfilter.commands.console import complain, output_folder, speaker

#: Files of the whole: the same figures as a table and for programs.
TABLE, SUMMARY, CONSTANTS = "recordings.csv", "recordings.json", "constants.html"


@dataclass(frozen=True)
class Replayed:
    """What came of one recording.

    Attributes
    ----------
    recording : str
        Its label, and the name of its folder.
    exit_code : int
        As `navfilter replay` of it alone.
    duration_s, distance_m : float
    position_rms_m : float
        Against the truth; NaN where there is none.
    sd_end_m : float
        Predicted standard deviation of the position at the end.
    cpu_s : float
        Processor time of filter and smoother [s].
    verdict : str
        The headline; or what was wrong, where nothing was written.
    """

    recording: str
    exit_code: int
    duration_s: float = math.nan
    distance_m: float = math.nan
    position_rms_m: float = math.nan
    sd_end_m: float = math.nan
    cpu_s: float = math.nan
    verdict: str = ""


def labels(missions: list[str]) -> list[str]:
    """Names for recordings, each once: the folder's or the file's, with that of the folder above where two are alike.

    Raises
    ------
    ValueError
        When the same recording is named twice.
    """
    paths = [Path(mission).resolve() for mission in missions]
    if len(set(paths)) < len(paths):
        raise ValueError(f"{next(p for p in paths if paths.count(p) > 1)} is named twice; name each recording once.")
    # of a folder with a mission.toml that file says nothing
    parts = [path.parent.parts if path.name == "mission.toml" else (*path.parent.parts, path.stem) for path in paths]
    for depth in range(1, max(map(len, parts)) + 1):
        found = ["-".join(part[-depth:]).strip("/\\") for part in parts]
        if len(set(found)) == len(found):
            return found
    raise ValueError("these recordings cannot be told apart by their names; rename one of: " + ", ".join(missions))


def replay_all(
    options: argparse.Namespace, replay: Callable[[argparse.Namespace], int], compile_first: Callable[[], None]
) -> int:
    """Replay every recording of the command line; a table of all, and the worst of their exit codes.

    Parameters
    ----------
    options : Namespace
        Of ``navfilter replay``, with several missions.
    replay : callable
        Replays the one mission of its options; importable by a worker.
    compile_first : callable
        Called once before the workers are started, so that they find the kernels compiled.
    """
    from navfilter.evaluation.montecarlo.workers import process_pool
    from navfilter.playback.warm_up import available_cores

    folder, say = output_folder(options.out, options.force), speaker(options.quiet)
    names = labels(options.mission)
    jobs = {
        name: argparse.Namespace(**{**vars(options), "mission": mission, "out": str(folder / name), "quiet": True})
        for name, mission in zip(names, options.mission, strict=True)
    }
    compile_first()
    workers = min(options.workers or available_cores(), len(jobs))
    say(f"replaying {len(jobs)} recordings on {workers} processes ...")
    done: dict[str, Replayed] = {}
    with process_pool(workers) as pool:
        waiting = {pool.submit(_replayed, name, job, replay): name for name, job in jobs.items()}
        for future in as_completed(waiting):
            name = waiting[future]
            try:
                done[name] = future.result()
            except BrokenProcessPool:
                done[name] = Replayed(name, 2, verdict="its process was ended, perhaps for want of memory")
            if not options.quiet:
                complain(f"{len(done)} of {len(jobs)}: {name}: {done[name].verdict}")
    rows = [done[name] for name in names]
    _write(rows, folder)
    say(_table(rows))
    constants = _write_constants([row.recording for row in rows if row.exit_code < 2], folder)
    say(f"Written to {folder}: {TABLE}, {SUMMARY}, {constants}and a folder for each recording.")
    for row in rows:
        if row.exit_code == 2:
            complain(f"navfilter: {row.recording}: {row.verdict}")
    return max((row.exit_code for row in rows), key=(0, 3, 1, 2).index)


def _replayed(name: str, options: argparse.Namespace, replay: Callable[[argparse.Namespace], int]) -> Replayed:
    """In a worker: one recording, and its figures from its summary.json."""
    try:
        with contextlib.redirect_stderr(io.StringIO()), contextlib.redirect_stdout(io.StringIO()):
            code = replay(options)
    except OSError as error:
        return Replayed(name, 2, verdict=f"{error.filename or name}: {error.strerror or error}.")
    except (ValueError, LookupError, MemoryError) as error:
        return Replayed(name, 2, verdict=str(error.args[0]) if error.args else type(error).__name__)
    found = json.loads((Path(options.out) / "summary.json").read_text(encoding="utf-8"))
    run = list(found["runs"].values())[-1]

    def number(value: Any) -> float:
        return math.nan if value is None else float(value)

    return Replayed(
        recording=name,
        exit_code=code,
        duration_s=number(found["duration_s"]),
        distance_m=number(found["distance_m"]),
        position_rms_m=number(run.get("position_rms_m")),
        sd_end_m=number(found["without_truth"]["sd_end_m"]),
        cpu_s=number(run["cpu_s"]),
        verdict=found["verdict"]["headline"],
    )


def _write(rows: list[Replayed], folder: Path) -> None:
    import pandas as pd

    from navfilter.io.write import write_json

    write_json([vars(row) for row in rows], folder / SUMMARY)
    pd.DataFrame([vars(row) for row in rows]).to_csv(folder / TABLE, index=False)


def _write_constants(names: list[str], folder: Path) -> str:
    """A page of what each recording found of every constant, and whether they agree; its name, or nothing."""
    from navfilter.calibration.lights import Light, agreement
    from navfilter.rendering.page import page
    from navfilter.report.constant_table import AGREEMENT, agreement_html

    said = [json.loads((folder / name / "summary.json").read_text(encoding="utf-8")) for name in names]
    each = [
        {
            key: Light(key, **{field: value for field, value in one.items() if field != "light"})
            for key, one in found.get("constants", {}).items()
        }
        for found in said
    ]
    found = {}
    for key in dict.fromkeys(key for lights in each for key in lights):
        lights = [one.get(key) for one in each]
        there = [light for light in lights if light is not None]
        found[key] = agreement([light.to_dict() for light in there]), there[0].unit, lights
    if len(names) < 2 or not found:
        return ""
    body = [agreement_html(names, found), f"<p>{AGREEMENT}</p>"]
    text = page("Constants", "Constants", f"{len(names)} recordings, vehicle {said[0]['vehicle']}.", body)
    (folder / CONSTANTS).write_text(text, encoding="utf-8")
    return f"{CONSTANTS} (whether they agree on the constants), "


def _table(rows: list[Replayed]) -> str:
    from navfilter.rendering.page import table_text

    header = ["recording", "min", "distance m", "rms m", "sd end m", "cpu s", "exit"]
    lines = []
    for row in rows:
        figures = (row.duration_s / 60.0, row.distance_m, row.position_rms_m, row.sd_end_m, row.cpu_s)
        forms = (".1f", ".0f", ".2f", ".2f", ".1f")
        cells = ["-" if math.isnan(value) else f"{value:{form}}" for value, form in zip(figures, forms, strict=True)]
        lines.append([row.recording, *cells, str(row.exit_code)])
    return table_text(header, lines)
