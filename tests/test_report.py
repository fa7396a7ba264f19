"""The report: figures that thin without hiding, tables that say what the summary says, a page that needs nothing
else.
"""

import ast
import dataclasses
import re
import xml.etree.ElementTree as ElementTree
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import chi2
from small_run import small_run

import navfilter
from navfilter.filter.records import OUTCOMES, Residuals
from navfilter.io.write import summarise
from navfilter.rendering.clock import clock_of
from navfilter.rendering.drawing import draw, style, svg
from navfilter.rendering.thinning import broken, envelope, extremes, straightened
from navfilter.report import figures
from navfilter.report.figures import shown_states, states_figure
from navfilter.report.instrument import draw_plan, plan_view
from navfilter.report.report import render_report
from navfilter.report.run_tables import headline_table, sensor_table


def images(page):
    """The SVG documents inside a page."""
    return [unquote(data.replace("&amp;", "&")) for data in re.findall(r'src="data:image/svg\+xml,([^"]+)"', page)]


@settings(max_examples=60)
@given(
    values=st.lists(st.one_of(st.floats(-1e6, 1e6), st.just(float("nan"))), min_size=1, max_size=600),
    stretches=st.integers(1, 40),
)
def test_an_envelope_hides_nothing(values, stretches):
    value = np.array(values)
    time, thin = envelope(np.arange(float(value.size)), value, stretches)
    assert len(thin) <= max(4 * stretches, 1)
    assert (np.diff(time) > 0).all()
    np.testing.assert_array_equal(thin, value[time.astype(int)])
    if np.isfinite(value).any():
        assert np.nanmin(thin) == np.nanmin(value) and np.nanmax(thin) == np.nanmax(value)


def test_an_envelope_keeps_gaps_open():
    time = np.concatenate([np.arange(0.0, 5000.0), np.arange(9000.0, 14000.0)])
    _, thin = envelope(*broken(time, np.sin(time)), stretches=300)
    assert np.isnan(thin).sum() == 1


def test_a_thinned_band_holds_the_band():
    rng = np.random.default_rng(1)
    high = rng.uniform(1.0, 2.0, 10_001)
    time, low, top = extremes(np.arange(10_001.0), -high, high, 100)
    assert len(time) <= 100 and top.max() == high.max() and low.min() == -high.max()
    assert (top >= np.interp(time, np.arange(10_001.0), high)).all()


def test_what_is_straight_is_left_out_and_nothing_else():
    x = np.arange(4001.0)
    y = np.where(x < 2000.0, 0.001 * x, np.sin(x / 50.0))
    y[1000], y[3000] = np.nan, 5.0
    thin_x, thin = straightened(x, y, 0.01)
    assert len(thin) < len(y) / 3 and np.isnan(thin).sum() == 1 and np.nanmax(thin) == 5.0
    # each of the four passes may move the line by its tolerance
    assert np.nanmax(np.abs(np.interp(x, thin_x, thin) - y)) < 0.04


def test_long_series_make_small_figures():
    _, tracks = small_run()
    n, rng = 200_000, np.random.default_rng(2)
    value = rng.normal(size=(n, 1))
    outcome = np.where(rng.random(n) < 0.2, OUTCOMES.index("rejected"), 0).astype(np.uint8)
    many = Residuals(np.linspace(0, 150, n), value, np.ones((n, 1)), value[:, 0] ** 2, np.ones(n), outcome)
    track = dataclasses.replace(tracks["forward"], residuals={"depth": many})
    with style():
        # 200 000 points would be about 4 MB; what remains is two edges per pixel and 1500 crosses.
        assert len(svg(draw(figures.innovation_figure(track, "depth"), clock_of(tracks)))) < 250_000


def test_the_same_figure_is_the_same_file():
    mission, tracks = small_run()

    def drawn():
        with style():
            return svg(draw(figures.position_figure(tracks, mission.truth), clock_of(tracks)))

    assert drawn() == drawn()


def test_nis_bounds_hold_95_percent_of_honest_means():
    _, tracks = small_run()
    n = 40_000
    nis = chi2.rvs(2, size=n, random_state=3)
    honest = Residuals(
        np.arange(float(n)), np.zeros((n, 2)), np.ones((n, 2)), nis, np.full(n, 2.0), np.zeros(n, np.uint8)
    )
    track = dataclasses.replace(tracks["forward"], residuals={"gps": honest})
    _, mean, low, high = figures.moving_nis(track, "gps")
    # 100 independent windows: the share inside is 0.95 with a standard deviation of 0.022 at most.
    assert 0.87 < np.mean((mean > low) & (mean < high)) <= 1.0
    np.testing.assert_allclose(mean.mean(), 1.0, atol=0.02)


def test_ellipses_are_those_of_the_covariance():
    mission, tracks = small_run()
    track = tracks["forward"]
    P = np.array([[9.0, 0.0], [0.0, 1.0]])  # 3 m north, 1 m east
    covariance = track.covariance.copy()
    covariance[:, :2, :2] = P
    plan = plan_view({"forward": dataclasses.replace(track, covariance=covariance)}, mission, ellipses=3)
    shapes = plan.runs[0].ellipses
    assert len(shapes) == 3
    turned = abs(np.sin(shapes[0].angle)) > 0.5
    axes = (shapes[0].height, shapes[0].width) if turned else (shapes[0].width, shapes[0].height)
    np.testing.assert_allclose(np.array(axes) / 2, np.sqrt(chi2.ppf(0.95, 2)) * np.array([1.0, 3.0]))
    with style():
        assert draw_plan(plan).axes[0].get_aspect() == 1.0


def test_truth_lies_on_the_track_in_the_plan():
    mission, tracks = small_run()
    plan = plan_view(tracks, mission)
    with style():
        ax = draw_plan(plan).axes[0]
    lines = {line.get_label(): line.get_xydata() for line in ax.get_lines()}
    assert {"forward", "smoothed", "truth", "gps fixes used", "start", "end"} <= set(lines)
    error = tracks["smoothed"].errors(mission.truth).position_n[-1]
    np.testing.assert_allclose(lines["smoothed"][-1] - lines["truth"][-1], error[1::-1], atol=0.02)


def test_degrees_of_the_plan_are_those_of_the_track():
    mission, tracks = small_run()
    plan, track = plan_view(tracks, mission), tracks["smoothed"]
    run = plan.runs[-1]
    # over some hundred metres a plane is true to a centimetre: 1e-7 deg
    np.testing.assert_allclose(
        plan.latitude_deg + plan.north_deg * run.north, np.degrees(track.latitude), atol=2e-7, rtol=0
    )
    np.testing.assert_allclose(
        plan.longitude_deg + plan.east_deg * run.east, np.degrees(track.longitude), atol=2e-7, rtol=0
    )


@pytest.mark.parametrize("scenario", ["reckoning", "lawnmower"])
def test_shown_states_are_states_of_the_track(scenario):
    _, tracks = small_run(scenario)
    track = tracks["forward"]
    shown = shown_states(track.vehicle)
    assert {state.name for state in shown} <= set(track.state_names)
    assert {state.owner for state in shown} == (
        {"drive", "gps"} if scenario == "reckoning" else {"gyro", "accel", "compass", "gps"}
    )
    with style():
        axes = draw(states_figure(tracks, shown), clock_of(tracks)).axes
    assert len(axes) == len(shown) and all(
        ax.get_ylabel().endswith(f"[{state.unit}]") for ax, state in zip(axes, shown, strict=True)
    )


class Page(HTMLParser):
    """What a browser would fetch, and whether the tags match."""

    def __init__(self, text):
        super().__init__()
        self.fetched, self.open, self.text = [], [], ""
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.fetched += [value for name, value in attrs if name in ("src", "href")]
        if tag not in ("meta", "img", "input"):
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.text += data if self.open[-1:] != ["script"] else ""


def test_the_page_needs_nothing_else():
    mission, tracks = small_run()
    steps = []
    page = render_report(tracks, mission, lambda: steps.append(1))
    parsed = Page(page)
    assert not parsed.open and "@import" not in page
    assert parsed.fetched and all(link.startswith(("data:image/svg+xml,", "#")) for link in parsed.fetched)
    pictures = images(page)
    assert len(pictures) == len(steps) == page.count("<figcaption>") >= 8
    for picture in pictures:
        for element in ElementTree.fromstring(picture).iter():
            for name, value in element.attrib.items():
                assert not name.endswith("href") or value.startswith("#")
    for heading in (
        "Result",
        "Position error",
        "Heading error",
        "NIS per sensor",
        "innovations",
        "estimated error",
        "Readings",
    ):
        assert heading in parsed.text


def test_a_page_without_truth_says_so():
    mission, tracks = small_run()
    page = render_report(tracks, dataclasses.replace(mission, truth=None))
    assert "no truth" in page and "Honesty of the covariance" not in page and "nan" not in Page(page).text.lower()


def test_names_are_escaped():
    mission, tracks = small_run()
    page = render_report(tracks, dataclasses.replace(mission, name="<b>dive & co</b>", notes=("gps: <none>",)))
    assert "<b>dive" not in page and "&lt;b&gt;dive &amp; co" in page and "gps: &lt;none&gt;" in page


def test_several_models_stand_side_by_side():
    mission, tracks = small_run()
    other = dataclasses.replace(
        tracks["forward"], residuals={"gps": tracks["forward"].residuals["gps"]}, state_names=()
    )
    page = render_report({"GM1": tracks["forward"], "white": other}, mission)
    text = Page(page).text
    assert "gps (GM1): innovations" in text and "gps (white): innovations" in text
    assert headline_table({"GM1": tracks["forward"], "white": other}, mission).count("\n") == 2


def test_tables_say_what_the_summary_says():
    mission, tracks = small_run()
    run = summarise(tracks, mission)["runs"]["smoothed"]
    row = headline_table(tracks, mission).splitlines()[-1].split()
    assert row[0] == "smoothed" and row[1] == f"{run['position_rms_m']:.2f}" and row[8] == f"{run['nees_heading']:.2f}"
    gps = next(line.split() for line in sensor_table(tracks["smoothed"]).splitlines() if line.startswith("gps"))
    assert gps[1:4] == [str(run[key]["gps"]) for key in ("used", "rejected", "invalid")]


def test_no_module_draws_through_pyplot():
    folder = Path(navfilter.__file__).parent
    for path in folder.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import | ast.ImportFrom) else []
            module = getattr(node, "module", None) or ""
            assert not any("pyplot" in name for name in (*names, module)), path.name
