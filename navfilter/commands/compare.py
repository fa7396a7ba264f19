"""``navfilter compare``: its arguments and what it does. Everything heavy is imported where it is used."""

from __future__ import annotations

import argparse
import dataclasses
import os
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from navfilter.commands import console

if TYPE_CHECKING:
    from navfilter.evaluation.comparison import Comparison
    from navfilter.models.mission import Mission
    from navfilter.models.vehicle import Vehicle
    from navfilter.track.track import Track, Tracks

#: What ratios refer to: the first of these that is among the models, else the first model.
BASELINES = ("gm1-fitted", "gm1", "vehicle", "white")


def names(text: str) -> tuple[str, ...]:
    """Names with commas between them, each once."""
    names = tuple(dict.fromkeys(part.strip() for part in text.split(",") if part.strip()))
    if not names:
        raise argparse.ArgumentTypeError(f"must be names with commas between them, found '{text}'")
    return names


def run(options: argparse.Namespace) -> int:
    """Run a mission with several kinds of error models and compare what they make of it.

    the models, by name, for the sensors that correct:
      white        white noise                                  fitted to the whole mission by likelihood
      gm1          first-order Gauss-Markov                     through the 1/e point of the autocorrelation
      gm1-fitted   first-order Gauss-Markov                     fitted to the whole mission by likelihood
      arma         learnt on the way, order and coefficients    begins with vehicle.toml's model, sees only the past
      vehicle      as vehicle.toml says
      iae, sage-husa, vb, imm, student-t                        white noise that the run adapts, as the literature does
      oracle       the true models, from --oracle               only where the mission is simulated

    A mission does not say how its sensors really err: --oracle takes a second vehicle file that does. 'navfilter
    simulate' writes it as vehicle_true.toml where the scenario errs otherwise than its vehicle.toml believes.

    Tracks are scored as first given out: what running the beginning again with the first learnt models made of it is
    left out. --smooth compares what is known afterwards.

    written to --out:
      report.html      table and figures side by side, one file that works offline
      comparison.csv   one row per model, a column per figure
      summary.json     the same, with every model adopted under way, and the figures of the whole mission

    examples:
      navfilter compare dive_042 --vehicle dive_042 --models white,gm1-fitted,arma
      navfilter compare dive_042 --vehicle vehicle.toml --sensors compass --smooth --out compared
      navfilter simulate oscillating --out swing
      navfilter compare swing/mission.npz --vehicle swing --models arma,oracle --oracle swing/vehicle_true.toml --out a
    """
    from navfilter.evaluation.baselines import MODELS
    from navfilter.io import read_vehicle
    from navfilter.playback.instructions import instructed

    for name in options.models:
        if name not in MODELS:
            raise ValueError(f'--models: there is no model "{name}". Models: {", ".join(MODELS)}.')
    if options.oracle is not None and "oracle" not in options.models:
        raise ValueError("--oracle is only used by the model 'oracle': add it to --models.")
    if options.oracle is None and "oracle" in options.models:
        raise ValueError(
            "the model 'oracle' needs --oracle TOML: a vehicle file with the true error models. A mission does not "
            "hold them."
        )
    vehicle = read_vehicle(options.vehicle).without(*options.without)
    truth = None if options.oracle is None else true_errors(vehicle, read_vehicle(options.oracle))
    vehicle, mission = instructed(vehicle, console.read(options))
    folder = None if options.out is None else console.output_folder(options.out, options.force)
    plan = Plan(options.models, options.sensors, truth, options.models if options.smooth else (), options.output_rate)
    tracks = replay_models(plan, vehicle, mission, options.quiet)
    comparison = compare_tracks(tracks, mission, vehicle, options.sensors, options.begin)
    if not options.quiet:
        print_comparison(comparison, mission)
    if folder is not None:
        write_results(comparison, tracks, mission, folder, options.quiet)
        console.speaker(options.quiet)(
            f"Written to {folder}{os.sep}: report.html (open this one), comparison.csv, summary.json"
        )
    return 0


def true_errors(vehicle: Vehicle, really: Vehicle) -> dict[str, Any]:
    """Error models of the second vehicle for the sensors that both have."""
    return {name: really.sensors[name].error for name in vehicle.sensors if name in really.sensors}


@dataclass(frozen=True)
class Plan:
    """With which models a mission is replayed, and how.

    Attributes
    ----------
    models : sequence of str
        Names, see `navfilter.evaluation.baselines.rival`.
    sensors : sequence of str, optional
        Whose model is exchanged; default all with enough readings.
    truth : dict of str to ErrorModel or tuple of ErrorModel, optional
        For "oracle".
    smooth : sequence of str
        Models whose track is smoothed.
    output_rate_hz : float
    """

    models: Sequence[str]
    sensors: Sequence[str] | None = None
    truth: Mapping[str, Any] | None = None
    smooth: Sequence[str] = ()
    output_rate_hz: float = 5.0


def replay_models(plan: Plan, vehicle: Vehicle, mission: Mission, quiet: bool = False) -> dict[str, Track]:
    """Fit the rivals and replay the mission with each.

    Parameters
    ----------
    plan : Plan
    vehicle : Vehicle
    mission : Mission
    quiet : bool
        Say nothing on the way.

    Returns
    -------
    dict of str to Track
        By name of the model.
    """
    from navfilter.evaluation.baselines import fitted_kinds, replay_rival, rivals
    from navfilter.models.alignment import align

    say, bars = console.speaker(quiet), not quiet and sys.stderr.isatty()
    console.compile_first(quiet)
    # One start for all: an alignment uses the error models, and the rivals are to differ in nothing else.
    start = mission.start if mission.start is not None else align(vehicle, mission)
    if fitted_kinds(plan.models):
        say(f"fitting models to {mission.name} ({mission.duration_s / 60:.1f} min) ...")
    vehicles = rivals(tuple(plan.models), vehicle, mission, sensors=plan.sensors, truth=plan.truth, start=start)
    tracks, how = {}, {"start": start, "output_rate_hz": plan.output_rate_hz, "progress": bars}
    for number, (name, other) in enumerate(vehicles.items(), 1):
        say(f"replaying with {name} ({number} of {len(vehicles)}) ...")
        tracks[name] = replay_rival(name, other, mission, plan.sensors, smooth=name in plan.smooth, **how)
    return tracks


def compare_tracks(
    tracks: Tracks,
    mission: Mission,
    vehicle: Vehicle,
    sensors: Sequence[str] | None = None,
    begin_s: float | None = None,
) -> Comparison:
    """Compare runs by name of the model, from `begin_s` on if given.

    The result says where nothing could be fitted or learnt, so that a run kept the model of the vehicle file after all.
    """
    from navfilter.evaluation.comparison import compare

    remarks = _kept(tracks, vehicle, sensors)
    baseline = next((name for name in BASELINES if name in tracks), next(iter(tracks)))
    result = compare(tracks, mission.truth, begin_s=begin_s, windows=mission.windows, baseline=baseline)
    return dataclasses.replace(result, remarks=remarks)


def _kept(tracks: Tracks, vehicle: Vehicle, sensors: Sequence[str] | None) -> tuple[str, ...]:
    """One line on the axes for which a run was to have another model and had none, for want of readings."""
    kept: dict[str, list[str]] = {}
    for label in [name for name in tracks if name not in ("vehicle", "oracle")]:
        learnt = tracks[label].adopted()
        for name, sensor in vehicle.sensors.items():
            if not sensor.open_loop or (sensors is not None and name not in sensors):
                continue
            new = tracks[label].vehicle.sensors[name].models
            for axis, before, after in zip(sensor.axis_names, sensor.models, new, strict=True):
                title = f"{name} {axis}".strip()
                if title not in learnt if label == "arma" else before == after:
                    kept.setdefault(title, []).append(label)
    if not kept:
        return ()
    listed = "; ".join(f"{title} ({', '.join(labels)})" for title, labels in kept.items())
    return (f"Too few readings, so vehicle.toml stands: {listed}.",)


# --- results --------------------------------------------------------------------------------------------------------


def print_comparison(comparison: Comparison, mission: Mission) -> None:
    """The table on standard output."""
    console.show(f"\n{comparison}")
    if mission.truth is None:
        console.show("(no truth in this mission: only what the readings themselves tell)")


def write_results(comparison: Comparison, tracks: Tracks, mission: Mission, folder: Path, quiet: bool) -> None:
    """Write report.html, comparison.csv and summary.json."""
    from navfilter.evaluation.comparison import compare
    from navfilter.io.write import write_json, write_text
    from navfilter.report.comparison_page import adopted_models, render_comparison

    comparison.to_frame().to_csv(folder / "comparison.csv", index_label="model")
    whole = compare(tracks, mission.truth, windows=mission.windows, baseline=comparison.baseline)
    summary = {
        "mission": mission.name,
        "vehicle": next(iter(tracks.values())).vehicle.name,
        **comparison.to_dict(),
        "whole_mission": whole.to_dict()["runs"],
        "models": {label: track.summary()["models"] for label, track in tracks.items()},
        "adopted": adopted_models(tracks),
    }
    write_json(summary, folder / "summary.json")
    with console.figures_bar(quiet) as bar:
        write_text(render_comparison(comparison, tracks, mission, bar.update), folder / "report.html")
