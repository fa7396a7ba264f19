"""A short simulated mission and its runs, made once per process, for the tests of files, report and command line."""

from functools import cache

from navfilter.io.write import labelled
from navfilter.models.mission import Mission
from navfilter.playback.replay import replay
from navfilter.simulation.scenarios import simulate_scenario
from navfilter.track.track import Track


@cache
def small_run(scenario: str = "reckoning") -> tuple[Mission, dict[str, Track]]:
    """The mission and its forward and smoothed tracks by label."""
    vehicle, mission = simulate_scenario(scenario, seed=1, duration_s=150.0)
    return mission, labelled(replay(vehicle, mission, smooth=True))
