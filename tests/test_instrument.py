"""The live figures: what they are made of, the clock with UTC, marks, and a page that runs only its own scripts."""

import base64
import dataclasses
import gzip
import hashlib
import html
import json
import re

import numpy as np
import pytest
from small_run import small_run

from navfilter.evaluation.assessment import assess
from navfilter.filter.records import OUTCOMES
from navfilter.io.write import labelled
from navfilter.models.learned_arma import LearnedArma
from navfilter.playback.replay import replay
from navfilter.rendering.clock import Clock, clock_of
from navfilter.rendering.drawing import draw, style
from navfilter.rendering.page import Section, page
from navfilter.rendering.panels import Band, Line, Mark, Panel, Stack, extent, legend_of
from navfilter.report import figures
from navfilter.report.instrument import Instrument
from navfilter.report.live import live_stack, plain
from navfilter.report.report import marks, outages, render_report
from navfilter.simulation.scenarios import simulate_scenario

NOON_S = 1_767_268_800.0  # 2026-01-01 12:00 UTC


def payload(text, name):
    data = re.search(rf'<script type="application/gzip" id="{name}">([^<]*)<', text).group(1)
    return gzip.decompress(base64.b64decode(data)).decode()


def models(live, kind):
    """The models of one kind inside a figure, as plain values."""
    found = []

    def walk(value):
        if isinstance(value, dict):
            if value.get("name") == kind and "attributes" in value:
                found.append(value["attributes"])
            value = list(value.values())
        if isinstance(value, list | tuple):
            for part in value:
                walk(part)

    walk(live.item["doc"])
    return found


def entries(attributes):
    return dict(attributes["entries"])


def test_the_clock_counts_from_zero_and_knows_utc():
    clock = Clock(0.0, 3600.0, NOON_S)
    assert clock.unit == "min" and clock.label == "mission time [min]"
    np.testing.assert_allclose(clock(np.array([90.0])), 1.5)
    assert clock.tick(1.5) == "1.5\n12:01:30" and clock.tick(30.0) == "30\n12:30"
    assert Clock(0.0, 3600.0).tick(30.0) == "30" and Clock(0.0, 3600.0).utc(1.0) is None


def test_no_axis_counts_from_1970():
    clock = Clock(NOON_S, NOON_S + 500.0)
    np.testing.assert_allclose(clock(np.array([NOON_S + 20.0])), 20.0)
    assert clock.label == f"mission time - {NOON_S:.0f} s [s]" and clock.tick(20.0) == "20\n12:00:20"


def test_utc_stands_beside_mission_time():
    mission, tracks = small_run()
    dated = dataclasses.replace(mission, epoch_utc_s=NOON_S)
    clock = clock_of(tracks, dated)
    stack = figures.heading_figure(tracks, mission.truth)
    with style():
        ax = draw(stack, clock).axes[0]
        ax.figure.canvas.draw()
    assert ax.get_xlabel() == "mission time [s], UTC" and "12:00" in ax.get_xticklabels()[1].get_text()
    (utc,) = [r for r in models(live_stack(stack, clock), "Range1d") if r.get("name") == "utc"]
    offset, factor = utc["tags"]
    assert utc["start"] == pytest.approx(1000.0 * (NOON_S + clock.range[0] / clock.factor)) and factor == 1000.0
    assert offset == 1000.0 * NOON_S
    assert not [r for r in models(live_stack(stack, clock_of(tracks, mission)), "Range1d") if r.get("name") == "utc"]


def test_a_live_figure_shows_what_is_printed():
    """Every part is there by its label, thinned by less than a pixel."""
    x = np.linspace(0.0, 100.0, 50_000)
    y = np.sin(x)
    stack = Stack((Panel("a [m]", (Band(x, y - 0.1, y + 0.1, "±1σ", "#0072b2"), Line(x, y, "run", "#0072b2"))),))
    live = live_stack(stack, Clock(0.0, 100.0))
    assert [key.label for key in live.keys] == ["±1σ", "run"]
    line, *_ = [
        entries(source["data"]) for source in models(live, "ColumnDataSource") if len(source["data"]["entries"]) == 2
    ]
    shown = {
        name: np.frombuffer(gzip.decompress(base64.b64decode(v["array"]["data"])), np.float32)
        for name, v in line.items()
    }
    assert 100 < shown["x"].size < 2000
    # a tenth of a per cent of the range in each of four passes
    np.testing.assert_allclose(np.interp(x, shown["x"], shown["y"]), y, atol=0.01)
    assert len(json.dumps(live.item)) < 60_000


def test_limits_follow_the_shape():
    line = Line(np.arange(3.0), np.array([-1.0, 2.0, np.nan]), "run", "#000000")
    assert extent(Panel("a", (line,))) is None
    assert extent(Panel("a", (line,), shape="symmetric")) == pytest.approx((-2.1, 2.1))
    assert extent(Panel("a", (line,), shape="from zero")) == pytest.approx((0.0, 2.1))
    assert extent(Panel("a", (line,), (0.0, 1.0))) == (0.0, 1.0)
    stack = Stack((Panel("a", (line,)), Panel("b", (line, dataclasses.replace(line, label="other")))))
    assert [part.label for part in legend_of(stack, 1)] == ["other"]


def test_formulas_in_names_stay_names():
    """The drawing library would load what sets formulas from elsewhere."""
    shown = plain(r"gps $$\frac{1}{2}$$ \[x\] \(y\)")
    assert "$$" not in shown and r"\[" not in shown and r"\(" not in shown
    assert shown.replace("\N{ZERO WIDTH SPACE}", "") == r"gps $$\frac{1}{2}$$ \[x\] \(y\)"


def test_marks_of_outages_surfacings_and_adoptions():
    _, tracks = small_run()
    track = tracks["forward"]
    gps = track.residuals["gps"]
    hidden = np.where((gps.time_s > 40.0) & (gps.time_s < 100.0), OUTCOMES.index("rejected"), gps.outcome)
    silent = dataclasses.replace(gps, outcome=hidden.astype(np.uint8))
    track = dataclasses.replace(track, residuals={"gps": silent})
    (outage,) = outages(track, "gps")
    assert (outage.label, outage.begin_s, outage.end_s) == ("no gps", 40.0, 140.0)
    dived = outages(tracks["forward"], "gps")
    assert [(mark.begin_s, mark.end_s) for mark in dived] == [(83.0, 140.0)]
    found = assess({"forward": tracks["forward"]}, small_run()[0])
    noted = marks(tracks["forward"], found.evidence.surfacings, ())
    assert [mark.label for mark in noted] == ["no gps", *["surfacing"] * len(found.evidence.surfacings)]
    stack = Stack((Panel("a", (Line(np.arange(9.0), np.arange(9.0), "run", "#000000"),)),), marks=(outage,))
    live = live_stack(stack, Clock(0.0, 150.0))
    strip = models(live, "VStrip")[0]
    assert strip["fill_color"]["value"] == outage.hue and "no gps" in [key.label for key in live.keys]


def test_the_page_allows_its_own_scripts_and_nothing_else():
    mission, tracks = small_run()
    text = render_report(tracks, mission)
    policy = html.unescape(re.search(r'http-equiv="Content-Security-Policy" content="([^"]*)"', text).group(1))
    assert policy.startswith("default-src 'none'") and "http" not in policy and "unsafe-eval" not in policy
    allowed = re.search("script-src ([^;]*)", policy).group(1).split()
    scripts = [*re.findall(r"<script>(.*?)</script>", text, flags=re.DOTALL), payload(text, "library")]
    digests = [f"'sha256-{base64.b64encode(hashlib.sha256(s.encode()).digest()).decode()}'" for s in scripts]
    assert sorted(digests) == sorted(allowed) and len(scripts) == 3
    data = json.loads(payload(text, "figures"))
    assert len(data["figures"]) == text.count('class="live"') >= 8
    assert len({len(column) for column in data["rows"].values()}) == 1 and data["clock"]["utc"] is None


def test_the_verdict_stands_on_top_and_the_contents_name_every_section():
    mission, tracks = small_run()
    text = render_report(tracks, mission)
    titles = re.findall(r"<h2>([^<]*)</h2>", text)
    assert titles[0] == "Verdict" and {"Track", "Depth, speed, attitude", "gps", "Readings"} <= set(titles)
    linked = re.findall(r"<nav>.*</nav>", text, flags=re.DOTALL)[0]
    ids = re.findall(r'<section id="([^"]+)"', text)
    assert re.findall(r'href="#([^"]+)"', linked) == ids and len(set(ids)) == len(ids) == len(titles)


def test_anchors_of_any_title_differ():
    titles = ["a b", "a-b", "a_b", "ä", "<b>", "$$", "gps", "GPS"]
    anchors = [Section(title, (), sensor=title).anchor for title in titles]
    assert len(set(anchors)) == len(titles) and all(re.fullmatch(r"[A-Za-z0-9_-]+", anchor) for anchor in anchors)


def test_pages_without_figures_run_nothing():
    text = page("t", "h", "s", ["<p>x</p>"])
    assert "<script" not in text and "script-src" not in text and "default-src 'none'" in text


def test_a_mark_is_drawn_in_print_too():
    mission, tracks = small_run()
    mark = Mark(50.0, 60.0, "no gps", "no gps used for 10 s", "#8c6bb1")
    stack = dataclasses.replace(figures.heading_figure(tracks, mission.truth), marks=(mark,))
    with style():
        ax = draw(stack, clock_of(tracks)).axes[0]
    shaded = [c.get_paths()[0].get_extents() for c in ax.collections if c.get_alpha() == 0.13]
    assert [(box.x0, box.x1) for box in shaded] == [(50.0, 60.0)] and "no gps" in [
        t.get_text() for t in ax.get_legend().get_texts()
    ]


def test_per_cents_of_no_distance_are_left_out():
    mission, tracks = small_run()
    track = tracks["forward"]
    still = dataclasses.replace(track, velocity_n=0.0 * track.velocity_n)
    assert len(figures.position_figure({"still": still}, mission.truth).panels) == 3
    assert len(figures.position_figure({"moving": track}, mission.truth).panels) == 4


def test_the_demonstration_hour_fits_three_megabytes():
    vehicle, mission = simulate_scenario("demo", seed=1)
    track = replay(vehicle.with_error(compass=LearnedArma()), mission, smooth=True)
    text = render_report(labelled(track), mission)
    assert len(text.encode()) < 3_000_000
    assert "model adopted" in payload(text, "figures") and "What was learnt" in text


def test_progress_is_told_after_each_figure():
    mission, tracks = small_run()
    steps = []
    track = tracks["smoothed"]
    instrument = Instrument(clock_of(tracks), track, track, lambda: steps.append(1))
    shown = instrument.figure(figures.heading_figure(tracks, mission.truth), "a <caption>")
    assert len(steps) == 1 and "a &lt;caption&gt;" in shown and 'data-figure="0"' in shown
