"""The part of a report that is about one sensor at a time: innovations, what was learnt, estimated errors."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from navfilter.evaluation.learned_text import LearnedText
from navfilter.filter.records import OUTCOMES
from navfilter.rendering.page import Section, escape
from navfilter.rendering.panels import Mark, Stack
from navfilter.report import figures, learnt_figures, state_figures
from navfilter.report.instrument import Instrument
from navfilter.report.marks import adoptions, outages
from navfilter.track.track import Track, Tracks

#: A figure with more panels than this does not fit on a printed page.
_PANELS = 6


def sensor_sections(tracks: Tracks, learnt: tuple[LearnedText, ...], instrument: Instrument) -> Iterator[str | Section]:
    """A menu, and one section for each sensor and each part of the drive that has something to show.

    Parameters
    ----------
    tracks : dict of str to Track
    learnt : tuple of LearnedText
        Of the result.
    instrument : Instrument
    """
    states = _states(tracks)
    runs = figures.filters(tracks)
    judged = {n: None for t in runs.values() for n, r in t.residuals.items() if r.used.any() and n in t.vehicle.sensors}
    driven = next((track for track in reversed(list(tracks.values())) if state_figures.drive_residuals(track)), None)
    steps = {} if driven is None else state_figures.drive_residuals(driven)
    owners = list(judged | dict.fromkeys(states) | dict.fromkeys(steps))
    by_owner = {name: tuple(found for found in learnt if _owner(found.title, owners) == name) for name in owners}
    if owners:
        options = "".join(f'<option value="{escape(name)}">{escape(name)}</option>' for name in owners)
        yield f'<p class="choice"><label>Sensor <select class="sensors">{options}</select></label></p>'
    for name in owners:
        parts = [*_innovations(runs, name, by_owner[name], instrument)]
        if driven is not None and name in steps:
            parts.append(instrument.figure(*state_figures.steps_figure(driven, name)))
        end_s = max(float(track.time_s[-1]) for track in tracks.values())
        for caption, stack in learnt_figures.learnt_figures(by_owner[name], end_s):
            parts.append(instrument.figure(stack, caption))
        shown = states.get(name, ())
        for first in range(0, len(shown), _PANELS):
            stack = state_figures.states_figure(tracks, shown[first : first + _PANELS])
            marked = _marked(stack, next(iter(runs.values())), name, by_owner[name])
            parts.append(instrument.figure(marked, f"{name}: estimated error, with its 1-sigma band."))
        yield Section(name, tuple(parts), sensor=name)


def _owner(title: str, owners: list[str]) -> str | None:
    """Whose axis this is: "dvl x" is of "dvl"."""
    return max((name for name in owners if title == name or title.startswith(f"{name} ")), key=len, default=None)


def _innovations(runs: Tracks, name: str, learnt: tuple[LearnedText, ...], instrument: Instrument) -> Iterator[str]:
    for label, track in runs.items():
        if name not in track.residuals or name not in track.vehicle.sensors or not track.residuals[name].used.any():
            continue
        many = f" ({label})" if len(runs) > 1 else ""
        stack = _marked(figures.innovation_figure(track, name), track, name, learnt)
        yield instrument.figure(stack, f"{name}{many}: innovations, measured minus predicted, {_count(track, name)}.")


def _marked(stack: Stack, track: Track, name: str, learnt: tuple[LearnedText, ...]) -> Stack:
    """With the outages of the sensor, and the adoptions of its models."""
    found: list[Mark] = outages(track, name) + adoptions(learnt, float(track.time_s[0]))
    return replace(stack, marks=tuple(found))


def _states(tracks: Tracks) -> dict[str, tuple[state_figures.ShownState, ...]]:
    """The states worth showing, by owner."""
    by_owner: dict[str, dict[str, state_figures.ShownState]] = {}
    for track in tracks.values():
        for state in state_figures.shown_states(track.vehicle):
            # A state that nothing excites, such as a temperature term without temperatures, has nothing to show.
            if state.name in track.state_names and track.state(state.name)[1].any():
                by_owner.setdefault(state.owner, {})[state.name] = state
    return {owner: tuple(found.values()) for owner, found in by_owner.items()}


def _count(track: Track, name: str) -> str:
    r = track.residuals[name]
    return ", ".join(f"{r.count(outcome)} {outcome}" for outcome in OUTCOMES if r.count(outcome))
