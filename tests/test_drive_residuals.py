"""Residuals of what drives: standard normal where all is as described, and where a step is made they tell it."""

from dataclasses import replace

import numpy as np
import pytest

import navfilter as nf
from navfilter.report.figures import drive_residuals, steps_figure
from navfilter.simulation.scenarios import simulate_scenario

DURATION_S = 300.0


@pytest.fixture(scope="module")
def dives():
    """Smoothed tracks of three draws each."""
    return {
        name: [nf.replay(*simulate_scenario(name, seed, DURATION_S), smooth=True) for seed in (1, 2, 3)]
        for name in ("lawnmower", "reckoning")
    }


@pytest.mark.parametrize(("name", "axes"), [("lawnmower", 6), ("reckoning", 3)])
def test_they_are_standard_normal_where_all_is_as_described(dives, name, axes):
    """Neighbours are told by nearly the same readings, so that a run counts as some dozen of them."""
    found = []
    for track in dives[name]:
        step, sd = track.drive_steps.swapaxes(0, 1)
        assert step.shape == (len(track), axes) and track.forward.drive_steps is None
        found.append(np.nanmean((step[:-10] / sd[:-10]) ** 2))
    assert 0.6 < np.mean(found) < 1.5


def test_a_step_of_the_velocity_is_told_with_its_size(dives):
    """A small one, which the gate of the DVL lets by: of a larger one it is not known which of the two has erred."""
    vehicle, mission = simulate_scenario("lawnmower", 1, DURATION_S)
    imu = mission.streams["imu"]
    value, at_s = imu.value.copy(), 150.0
    value[(imu.time_s > at_s) & (imu.time_s <= at_s + 0.5), 3] += 0.08  # forward, 0.04 m/s in all
    streams = {**mission.streams, "imu": replace(imu, value=value)}
    track = nf.replay(vehicle, replace(mission, streams=streams), smooth=True)
    step, sd = track.drive_steps[:, :, 0].T
    told = (track.time_s > at_s) & (track.time_s < at_s + 15.0)
    row = np.flatnonzero(told)[np.argmax(np.abs(step / sd)[told])]
    assert step[row] == pytest.approx(0.04, abs=3.0 * sd[row]) and step[row] > 3.5 * sd[row]
    assert np.nanmax(np.abs(step / sd)) == step[row] / sd[row]


def test_parts_of_a_track_and_figures_have_them(dives):
    track = dives["lawnmower"][0]
    assert len(track.keep(slice(0, 7)).drive_steps) == 7 and track.at([100.0]).drive_steps is None
    assert list(drive_residuals(track)) == ["accel", "gyro"] and drive_residuals(track.forward) == {}
    stack, caption = steps_figure(track, "gyro")
    assert len(stack.panels) == 3 and "gyro: residuals" in caption and "deg." in caption
    assert list(drive_residuals(dives["reckoning"][0])) == ["drive"]
