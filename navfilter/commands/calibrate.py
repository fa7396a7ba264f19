"""``navfilter calibrate``: the constants of a vehicle from its missions, and the vehicle.toml with them."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from navfilter.commands import console

if TYPE_CHECKING:
    from navfilter.models.mission import Mission
    from navfilter.models.vehicle import Vehicle

OK, AS_IT_WAS = 0, 1


def run(options: argparse.Namespace) -> int:
    """Estimate clocks, lever arms, scales, mountings and compass deviation from missions, into a vehicle.toml.

    Estimated is what vehicle.toml is unsure of: constants with an sd above zero (time_offset_sd_s, lever_arm_sd_m,
    scale_sd, misalignment_sd_deg, deviation_sd_deg, ..). Where it is sure of everything, all kinds are opened: 0.3 s,
    0.3 m, 2 %, 3 deg, a deviation of 5 deg. --open opens some kinds beside those that the file gives.

    The constants are states of the filter; each step runs all missions, and the next one is linearised around what was
    found. The missions are then cut into stretches of up to a minute, dealt out to four parts. Without each part in
    turn the constants are estimated again, and the filter predicts the fixes of that part, with the old and with the
    new constants. Only when the new ones predict them better are they kept. Without any fixes, all readings of
    stretches of 30 s are withheld and judged by their likelihood.

    A light says how far each constant is told: green where its sd is no more than the limit (--limit, else 40 % of the
    sd that was described), orange up to twice that, red beyond.

    "not told" means that the missions leave more than 80 % of the sd that was described: turn more, vary the speed, or
    give fixes. A constant is only known against the others: the inertial unit's clock and place are the reference; of
    dead reckoning the attitude's clock is, and the antenna of the fixes.

    written to --out: your vehicle.toml, comments kept: clocks and lever arms in their keys, a misalignment turned into
    the mounting, scale and deviation as 'calibrated = {scale = [value, sd], ..}', each with its remaining sd.

    exit codes: 0 the new constants are kept; 1 they are not, the file written is the old one; 2 wrong usage or input;
    130 interrupted.

    examples:
      navfilter calibrate dive_042 --vehicle vehicle.toml --out calibrated.toml
      navfilter calibrate dive_0* --vehicle vehicle.toml --out calibrated.toml --json calibrated.json
      navfilter calibrate dive_042 --vehicle vehicle.toml --out calibrated.toml --open clock,mounting
      navfilter calibrate dive_042 --vehicle vehicle.toml --out calibrated.toml --truth 0.05    a reference as fixes
    """
    from navfilter.calibration.calibrate import calibrate, calibration_text, to_dict, with_reference
    from navfilter.calibration.parts import KINDS
    from navfilter.io import read_vehicle
    from navfilter.io.toml_editing import write_calibrated
    from navfilter.io.write import write_json
    from navfilter.playback.instructions import instructed

    out = Path(options.out)
    console.new_files([out, *([Path(options.json)] if options.json else [])], options.force)
    vehicle = read_vehicle(options.vehicle)
    console.limits_of(options)  # a mistake in them shall not cost a calibration
    missions = [instructed(vehicle, console.read(options, path))[1] for path in options.mission]
    single, missions, unit = _of_one_unit(vehicle, missions, options.imu)
    known = single
    for k, mission in enumerate(missions if options.truth else ()):
        known, missions[k] = with_reference(single, mission, options.truth)
    kinds = None if options.open is None else list(KINDS) if options.open == "all" else options.open.split(",")
    console.compile_first(options.quiet, known)
    result = calibrate(
        known, missions, kinds=kinds, each=options.each.split(","), report=None if options.quiet else _progress
    )
    say = console.speaker(options.quiet)
    if not options.quiet:
        _progress("")
    say(calibration_text(result, console.limits_of(options)))
    found = vehicle.with_lane(unit, result.vehicle)
    names = ", ".join(mission.name for mission in missions)
    copied = write_calibrated(found, vehicle, out, options.vehicle, f"found by navfilter calibrate: {names}")
    if options.json:
        write_json(to_dict(result), options.json)
    how = console.LAID_OUT_ANEW * (not copied)
    say(f"{out} written: {'with the constants found' if result.kept else 'as it was'}{how}.")
    return OK if result.kept else AS_IT_WAS


def _of_one_unit(vehicle: Vehicle, missions: list[Mission], unit: str | None) -> tuple[Vehicle, list[Mission], str]:
    """The vehicle and its missions with one of its inertial units, and which: constants are known against one."""
    from navfilter.models.lane_missions import of_one_unit

    if unit is None and len(vehicle.imus) > 1:
        raise ValueError(
            f"this vehicle has several inertial units ({', '.join(vehicle.imus)}): say with --imu NAME which one the "
            "constants are found against; calibrate the file written again with the next one."
        )
    name = unit or next(iter(vehicle.units), "")
    if unit is None and not vehicle.lanes():
        return vehicle, missions, name
    pairs = [of_one_unit(vehicle, mission, name) for mission in missions]
    return pairs[0][0], [mission for _, mission in pairs], name


def _progress(text: str) -> None:
    """One line on standard error that is written over, where somebody looks at it."""
    if sys.stderr is not None and sys.stderr.isatty():
        print(f"\r\033[K{text}", end="", file=sys.stderr, flush=True)
