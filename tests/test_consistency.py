"""Monte Carlo: what the filter and the smoother say about their errors is what their errors are.

Errors of one run are correlated in time, so the normalised estimation error squared (NEES) is taken at a few fixed
times and averaged over independent seeds: then it is chi-square with (seeds x components) degrees of freedom.
Innovations of a matching model are white, so the NIS of a sensor counts over all its readings. With so many figures,
one in twenty lies outside its 95 % band by chance: all must lie within the band that holds for the whole family with 95
% (Bonferroni), and at least 85 % within their own 95 % bands.
"""

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pytest
from scipy.stats import chi2

import navfilter as nf
from navfilter.simulation import presets
from navfilter.simulation.manoeuvres import ChangeSpeed, Dive, FigureEight, SpiralDive, Straight, Turn
from navfilter.simulation.motion import Motion, Wander
from navfilter.simulation.simulate import StartErrors, simulate

DEG = np.pi / 180.0
DURATION_S = 150.0
TIMES_S = (20.0, 60.0, 100.0, 140.0)
QUANTITIES = ("position", "velocity", "attitude")


def coloured(sd, rate_hz):
    """ARMA(2, 1) with a slow hump at about 0.1 Hz and white-ish part, of this standard deviation."""
    radius, angle = 0.97, 2.0 * np.pi * 0.1 / rate_hz
    ar, ma = (-2.0 * radius * np.cos(angle), radius**2), (-0.3,)
    unit = nf.Arma(ar=ar, ma=ma, sd=1.0).block(1.0 / rate_hz)
    return nf.Arma(ar=ar, ma=ma, sd=sd / np.sqrt(unit.C @ unit.P0 @ unit.C))


NOISES = {
    "white": lambda sd, rate_hz: nf.White(sd=sd),
    "gm1": lambda sd, rate_hz: nf.GaussMarkov(sd=sd, tau_s=20.0) + nf.White(sd=0.3 * sd),
    "arma": coloured,
}


def vehicle(drive, noise):
    error = NOISES[noise]
    dvl = nf.BodyVelocity(rate_hz=4.0, error=error(0.02, 4.0), lever_arm_b_m=(0.5, 0.1, 0.2))
    compass = nf.Heading(rate_hz=4.0, error=error(0.8 * DEG, 4.0))
    sensors = {
        "depth": nf.Depth(rate_hz=1.0, error=error(0.1, 1.0), lever_arm_b_m=(0.3, 0.0, -0.1)),
        "gps": nf.Position(rate_hz=0.5, error=error(2.0, 0.5), lever_arm_b_m=(-0.4, 0.1, -0.3)),
    }
    if drive == "imu":
        return nf.Vehicle(imu=presets.mems_imu(rate_hz=50.0), sensors={"compass": compass, "dvl": dvl, **sensors})
    tilt = error(0.3 * DEG, 4.0)
    return nf.Vehicle(nf.DeadReckoning(rate_hz=4.0, attitude=compass, velocity=dvl, tilt=tilt), sensors)


@cache
def motion():
    manoeuvres = (
        Straight(duration_s=10.0), Turn(80.0), Dive(5.0), FigureEight(rate_deg_s=6.0), SpiralDive(8.0), ChangeSpeed(1.0, 8.0), Turn(-150.0),
        Straight(duration_s=200.0),
    )  # fmt: skip
    return Motion(
        manoeuvres,
        latitude_deg=40.0,
        longitude_deg=-70.0,
        heading_deg=30.0,
        speed_m_s=1.5,
        depth_m=1.0,
        wander=Wander(),
    )


@dataclass(frozen=True)
class Figures:
    nees: dict  # (label, quantity) -> (seeds, times) sums of squares, and components
    nis: dict  # sensor -> (sum of squares, degrees of freedom)


@cache
def campaign(drive, noise, seeds):
    # Gates off: a gate at 0.9999 shaves the NIS, here the whole distribution is wanted.
    described = vehicle(drive, noise)
    described = nf.Vehicle(
        described.drive, {k: replace(s, gate_probability=1.0 - 1e-12) for k, s in described.sensors.items()}
    )
    nees = {(label, q): np.zeros((seeds, len(TIMES_S))) for label in ("forward", "smoothed") for q in QUANTITIES}
    nis = {name: np.zeros(2) for name in described.sensors}
    for seed in range(seeds):
        mission = simulate(
            described,
            motion(),
            seed=1000 + seed,
            duration_s=DURATION_S,
            start=StartErrors(heading_sd_deg=2.0, velocity_sd_m_s=0.05),
        )
        smoothed = nf.replay(described, mission, smooth=True, output_rate_hz=None)
        for track in (smoothed.forward, smoothed):
            rows = np.searchsorted(track.time_s, np.array(TIMES_S) - 1e-6)
            figures = track.nees(track.errors(mission.truth))
            for q in QUANTITIES:
                nees[track.label, q][seed] = figures[q][rows]
        for name, residuals in smoothed.residuals.items():
            assert residuals.used.all()
            nis[name] += residuals.nis.sum(), residuals.dof.sum()
    return Figures(nees, nis)


def judged(figures):
    """Rows of (name, mean per degree of freedom, degrees of freedom)."""
    rows = []
    for (label, quantity), values in figures.nees.items():
        rows += [
            (f"{label} {quantity} at {t:.0f} s", column.mean(), 3 * len(column))
            for t, column in zip(TIMES_S, values.T, strict=True)
        ]
    return rows + [(f"NIS {name}", total / dof, int(dof)) for name, (total, dof) in figures.nis.items()]


def band(dof, level):
    return chi2.ppf((1.0 - level) / 2.0, dof) / dof, chi2.ppf((1.0 + level) / 2.0, dof) / dof


def check(drive, noise, seeds):
    rows = judged(campaign(drive, noise, seeds))
    table, outside, far = [], 0, []
    for name, mean, dof in rows:
        (low, high), (lowest, highest) = band(dof, 0.95), band(dof, 1.0 - 0.05 / len(rows))
        outside += not low <= mean <= high
        if not lowest <= mean <= highest:
            far.append(name)
        table.append(f"{name:32s} {mean:6.3f}  [{low:.3f}, {high:.3f}]{'' if low <= mean <= high else '  <-'}")
    text = f"{drive}, {noise}, {seeds} seeds\n" + "\n".join(table)
    print(text)
    assert not far, f"outside the family-wise band: {far}\n{text}"
    assert outside <= 0.15 * len(rows), text


@pytest.mark.parametrize("noise", NOISES)
@pytest.mark.parametrize("drive", ["imu", "reckoning"])
def test_errors_are_what_the_covariance_says(drive, noise):
    # Attitudes that drive are the same readings forward and smoothed, so that ten draws outside their band count twice.
    check(drive, noise, 20)


@pytest.mark.slow
@pytest.mark.parametrize("noise", NOISES)
@pytest.mark.parametrize("drive", ["imu", "reckoning"])
def test_errors_are_what_the_covariance_says_in_fifty_runs(drive, noise):
    check(drive, noise, 50)
