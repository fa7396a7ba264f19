"""Comparison of runs: the figures are those of the runs, the ranges hold what they promise, nobody gains by
rejecting.
"""

import dataclasses
import json

import numpy as np
import pytest
from scipy.signal import lfilter
from small_run import small_run

import navfilter as nf
from navfilter.evaluation import over_dives_text
from navfilter.evaluation.comparison import independent, innovation_series
from navfilter.filter.records import OUTCOMES, Residuals
from navfilter.foundation.chi_square import chi_square_range
from navfilter.models.error_models import GaussMarkov
from navfilter.models.learned_arma import LearnedArma
from navfilter.models.sensors.traits import shown_unit
from navfilter.report.comparison_page import adopted_models, drawn, render_comparison
from navfilter.timeseries.model import ArmaModel

REJECTED = OUTCOMES.index("rejected")


def with_residuals(track, **residuals):
    return dataclasses.replace(track, residuals=residuals)


def readings(value, rejected=(), period_s=1.0, sd=1.0):
    """Residuals of a scalar sensor whose honest sd is `sd`."""
    value = np.asarray(value, float)[:, None]
    outcome = np.zeros(len(value), np.uint8)
    outcome[list(rejected)] = REJECTED
    z = value / sd
    return Residuals(
        period_s * np.arange(len(value)), value, np.full_like(value, sd), z[:, 0] ** 2, np.ones(len(value)), outcome
    )


def coloured(phi, n, seed):
    """A Gaussian AR(1) series of unit variance that starts in its stationary distribution."""
    e = np.random.default_rng(seed).standard_normal(n)
    e[0] /= np.sqrt(1.0 - phi**2)
    return np.sqrt(1.0 - phi**2) * lfilter([1.0], [1.0, -phi], e)


@pytest.fixture(scope="module")
def runs():
    mission, tracks = small_run("lawnmower")
    return mission, tracks


def test_figures_are_those_of_the_summary(runs):
    mission, tracks = runs
    result = nf.compare(tracks, truth=mission.truth)
    for label, track in tracks.items():
        summary, run = track.summary(mission.truth), result.runs[label]
        for key in (
            "position_rms_m",
            "position_max_m",
            "position_end_m",
            "position_end_pct",
            "heading_rms_deg",
            "velocity_rms_m_s",
        ):
            assert run[key] == summary[key]
        # The mean over a slice and over all rows may differ in the last digit.
        assert run["nees"]["heading"]["mean"] == pytest.approx(summary["nees_heading"], rel=1e-12)
        assert run["nees"]["position"]["mean"] == pytest.approx(summary["nees_position"], rel=1e-12)
        assert {name: sensor["nis"] for name, sensor in run["sensors"].items()} == summary["nis"]
        assert run["cpu_s"] == track.cpu_s


def test_prediction_errors_and_whiteness_are_those_of_the_innovations(runs):
    track = runs[1]["forward"]
    axis = nf.compare({"a": track}).runs["a"]["sensors"]["compass"]["axes"]["compass"]
    r = track.residuals["compass"]
    assert axis["prediction_rms"] == pytest.approx(np.degrees(np.sqrt(np.mean(r.value[r.used, 0] ** 2))), rel=1e-12)
    z = r.value[r.used, 0] / r.sd[r.used, 0]
    # All readings of this mission are there and used, so the series on the ticks is the plain series.
    assert axis["ljung_box_p"] == pytest.approx(nf.whiteness(z, lags=20).ljung_box_p, rel=1e-9)
    assert abs(axis["largest_acf"]) == pytest.approx(np.abs(nf.acf(z, 20)[1:]).max(), rel=1e-9)
    assert (
        nf.compare({"a": track}).runs["a"]["sensors"]["dvl"]["unit"] == "m/s"
        and shown_unit(track.vehicle.sensors["compass"].unit)[0] == "deg"
    )


def test_white_and_coloured_innovations_are_told_apart(runs):
    track = runs[1]["forward"]
    white = with_residuals(track, depth=readings(coloured(0.0, 150, 1)))
    slow = with_residuals(track, depth=readings(coloured(0.8, 150, 1)))
    result = nf.compare({"white": white, "slow": slow})
    axes = {label: run["sensors"]["depth"]["axes"]["depth"] for label, run in result.runs.items()}
    assert axes["white"]["is_white"] and not axes["slow"]["is_white"]
    assert axes["slow"]["largest_acf"] > 0.6 and axes["slow"]["ljung_box_p"] < 1e-6
    line = next(line for line in str(result).splitlines() if line.startswith("depth: largest autocorrelation"))
    assert line.split()[3] == "white" and line.count("white") == 1


def test_nothing_is_gained_by_rejecting(runs):
    """Prediction errors count the readings that all runs have used; the counts tell who rejected how many."""
    track = runs[1]["forward"]
    value = coloured(0.0, 140, 3)
    value[::10] *= 8.0
    tolerant, strict = readings(value), readings(value, rejected=range(0, 140, 10))
    result = nf.compare(
        {"tolerant": with_residuals(track, depth=tolerant), "strict": with_residuals(track, depth=strict)}
    )
    depth = {label: run["sensors"]["depth"] for label, run in result.runs.items()}
    assert depth["tolerant"]["axes"]["depth"]["prediction_rms"] == depth["strict"]["axes"]["depth"]["prediction_rms"]
    assert (
        depth["strict"]["rejected"] == 14
        and depth["tolerant"]["rejected"] == 0
        and depth["tolerant"]["compared"] == 126
    )
    # The share beyond 3 sigma counts rejected readings too: hiding them is not honesty.
    assert depth["strict"]["outside_3_sigma"] == depth["tolerant"]["outside_3_sigma"] > 0.02


def test_the_score_begins_where_asked(runs):
    mission, tracks = runs
    track = tracks["forward"]
    late = nf.compare({"a": track}, mission.truth, begin_s=60.0)
    errors = track.errors(mission.truth)
    after = track.time_s >= 60.0
    assert late.runs["a"]["heading_rms_deg"] == pytest.approx(
        np.degrees(np.sqrt(np.mean(errors.heading[after] ** 2))), rel=1e-12
    )
    r = track.residuals["compass"]
    assert late.runs["a"]["sensors"]["compass"]["used"] == np.count_nonzero(r.used & (r.time_s >= 60.0))
    assert late.windows == ((60.0, track.time_s[-1]),) and "60 to" in str(late)
    both = nf.compare({"a": track}, mission.truth, begin_s=60.0, windows=((0.0, 50.0), (40.0, 100.0)))
    assert both.windows == ((60.0, 100.0),)


def test_a_gap_leaves_room_in_the_series():
    r = readings(np.arange(6.0))
    r = dataclasses.replace(r, time_s=np.array([0.0, 1.01, 1.99, 5.0, 6.0, 500.0]))
    series = innovation_series(r, 0)
    np.testing.assert_array_equal(np.flatnonzero(np.isfinite(series)), [0, 1, 2, 5, 6, 46])
    np.testing.assert_array_equal(series[np.isfinite(series)], np.arange(6.0))


@pytest.mark.parametrize("phi", [0.0, 0.9, 0.98])
def test_correlated_errors_count_for_as_many_as_they_are_worth(phi):
    n = 20_000
    found = np.median([independent(coloured(phi, n, seed)) for seed in range(9)])
    # Squares of an AR(1) correlate as phi^2k: n (1 - phi^2) / (1 + phi^2) independent ones. The estimate thins to 4000
    # and ends its sum at the first zero, so it is true to some 15 %.
    exact = n * (1.0 - phi**2) / (1.0 + phi**2)
    assert found == pytest.approx(min(exact, 20_000 / 5), rel=0.25)


def test_the_range_of_a_nees_holds_95_percent_of_honest_runs():
    inside = 0
    for seed in range(300):
        z = coloured(0.95, 1500, seed)
        low, high = chi_square_range(independent(z))
        inside += low <= np.mean(z**2) <= high
    # 95 % of 300 with an sd of 1.3 %; the number of independent errors is itself estimated, which costs some per cent.
    assert 0.88 < inside / 300 <= 1.0


def test_ratios_and_stars(runs):
    mission, tracks = runs
    track = tracks["forward"]
    bold = dataclasses.replace(track, covariance=track.covariance / 100.0)
    text = str(nf.compare({"base": track, "bold": bold}, mission.truth, baseline="base"))
    row = next(line for line in text.splitlines() if line.startswith("heading rms"))
    assert row.count("(1.00)") == 1 and "ratio to base" in text
    row = next(line for line in text.splitlines() if line.startswith("NEES position"))
    assert row.rstrip().endswith("*")
    table = text.splitlines()[
        1 : text.splitlines().index(next(line for line in text.splitlines() if line.startswith("processor")))
    ]
    assert len({line.index(":") for line in table if line.startswith("dvl")}) == 1


def test_a_smoothed_track_is_judged_by_its_states_and_the_innovations_of_its_filter(runs):
    mission, tracks = runs
    result = nf.compare(tracks, mission.truth)
    assert result.runs["forward"]["sensors"] == result.runs["smoothed"]["sensors"]
    assert result.runs["forward"]["heading_rms_deg"] != result.runs["smoothed"]["heading_rms_deg"]


def test_without_truth_only_the_readings_speak(runs):
    _, tracks = runs
    result = nf.compare(tracks)
    text = str(result)
    assert (
        "position rms" not in text
        and "NEES position" not in text
        and "compass: NIS" in text
        and "nan" not in text.lower()
    )
    assert result.runs["forward"]["heading_rms_deg"] is None


def test_as_values_and_as_table(runs):
    mission, tracks = runs
    result = nf.compare(tracks, mission.truth, baseline="forward")
    assert (
        json.loads(json.dumps(result.to_dict()))["runs"]["forward"]["position_rms_m"]
        == result.runs["forward"]["position_rms_m"]
    )
    frame = result.to_frame()
    assert list(frame.index) == list(tracks)
    assert (
        frame.loc["smoothed", "sensors.dvl.axes.x.prediction_rms"]
        == result.runs["smoothed"]["sensors"]["dvl"]["axes"]["x"]["prediction_rms"]
    )
    assert frame.loc["forward", "nees.heading.band_low"] == result.runs["forward"]["nees"]["heading"]["band"][0]


def test_wrong_input_is_said(runs):
    mission, tracks = runs
    with pytest.raises(ValueError, match="at least one track"):
        nf.compare({})
    with pytest.raises(ValueError, match='baseline "gm1" is none of the runs'):
        nf.compare(tracks, baseline="gm1")
    with pytest.raises(ValueError, match="nothing is left to be scored after 1e"):
        nf.compare(tracks, mission.truth, begin_s=1e9)


# --- the page -------------------------------------------------------------------------------------------------------


def learnt(track):
    """The same track as if its compass had adopted three models, and the DVL some for its second axis."""
    models = [ArmaModel([-0.9], [], 0.01), ArmaModel([-1.5, 0.7], [0.3], 0.01), ArmaModel([-1.5, 0.7], [0.3], 0.012)]
    begin = GaussMarkov(sd=0.01, tau_s=30.0)
    compass = [(0.0, (begin,)), *((30.0 * k, (LearnedArma(prior=begin, model=m),)) for k, m in enumerate(models, 1))]
    white = nf.White(sd=0.01)
    dvl = [(0.0, (white,) * 3), (50.0, (white, white + LearnedArma(prior=begin, model=models[0]), white))]
    return dataclasses.replace(track, error_models={"compass": compass, "dvl": dvl})


def test_the_history_of_what_was_learnt(runs):
    _, tracks = runs
    track = learnt(tracks["forward"])
    histories = over_dives_text.learnt(track)
    assert [h.title for h in histories] == ["compass", "dvl y"]
    assert histories[0].time_s == (30.0, 60.0, 90.0) and [m.p for m in histories[0].models] == [1, 2, 2]
    plain = adopted_models({"arma": track, "gm1": tracks["forward"]})
    assert list(plain) == ["arma"]
    assert plain["arma"]["compass"][0]["pole_radius"] == pytest.approx(0.9) and plain["arma"]["compass"][1]["ma"] == [
        0.3
    ]
    assert plain["arma"]["compass"][1]["pole_radius"] == pytest.approx(np.sqrt(0.7))


def test_the_page_shows_every_run(runs):
    mission, tracks = runs
    shown = {"gm1-fitted": tracks["forward"], "arma": learnt(tracks["forward"])}
    comparison = nf.compare(shown, mission.truth, begin_s=30.0, baseline="gm1-fitted")
    steps = []
    page = render_comparison(comparison, shown, mission, lambda: steps.append(1))
    for heading in (
        "Error against 1 sigma",
        "Honesty of the covariance",
        "NIS per sensor",
        "What is left in the innovations",
        "Models learnt",
    ):
        assert heading in page
    assert page.count("<figcaption>") == len(steps) >= 8
    assert "the last one of order (2, 1)" in page and "heading rms [deg]" in page


def test_the_page_without_truth(runs):
    mission, tracks = runs
    blind = dataclasses.replace(mission, truth=None)
    titles = [title for title, _, _ in drawn(nf.compare(tracks), tracks, blind)]
    assert "Error against 1 sigma" not in titles and "What is left in the innovations" in titles


def test_panels_of_all_runs_share_one_scale(runs):
    mission, tracks = runs
    figure = next(
        figure
        for title, _, figure in drawn(nf.compare(tracks, mission.truth), tracks, mission)
        if title == "Error against 1 sigma"
    )
    assert len({panel.limits for panel in figure.panels}) == 1 and len(figure.panels) == 2
