"""``navfilter vehicle``: write a commented vehicle.toml to start from, or say in words what one describes."""

import argparse
from pathlib import Path

from navfilter.commands.console import speaker

OK, FOUND = 0, 1


def run(options: argparse.Namespace) -> int:
    """Write a commented vehicle.toml to start from, or say what one describes and whether it is plausible.

    --check prints the drive, the sensors with their error models in plain words, the number of states, and warns of
    numbers that look like another unit than their key says. Exit code: 0 all is well, 1 something looks wrong, 2 the
    file cannot be read.

    examples:
      navfilter vehicle --init                                  writes vehicle.toml here
      navfilter vehicle --init dive_042 --drive dead-reckoning  into a folder, for a vehicle without an inertial unit
      navfilter vehicle --check dive_042/vehicle.toml
    """
    return _init(options) if options.check is None else _check(options)


def _init(options: argparse.Namespace) -> int:
    from navfilter.io.vehicle_template import vehicle_template

    path = Path(options.init)
    if path.is_dir():
        path = path / "vehicle.toml"
    try:
        with path.open("w" if options.force else "x", encoding="utf-8", newline="\n") as file:
            file.write(vehicle_template(options.drive))
    except FileExistsError:
        raise ValueError(f"{path} is there already; choose another name, or --force to replace it.") from None
    say = speaker(options.quiet)
    say(f"{path} written. Change what is different on your vehicle, then:")
    say(f"  navfilter vehicle --check {path}")
    return OK


def _check(options: argparse.Namespace) -> int:
    from navfilter.check.description import describe_vehicle
    from navfilter.check.plausibility import check_vehicle
    from navfilter.io import read_vehicle

    vehicle = read_vehicle(options.check)
    findings = check_vehicle(vehicle)
    wrong = [finding for finding in findings if finding.severity != "info"]
    say = speaker(options.quiet)
    say(describe_vehicle(vehicle))
    for heading, of_kind in (("Worth a look", wrong), ("Worth knowing", [f for f in findings if f.severity == "info"])):
        if of_kind:
            say(f"\n{heading}:")
        for finding in of_kind:
            say("\n".join(finding.lines()))
    if not wrong:
        say("\nNothing looks wrong.")
    return FOUND if wrong else OK
