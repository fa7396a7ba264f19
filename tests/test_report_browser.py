"""The report in a real browser: it renders, zooms, says nothing on the console, asks nobody for anything, and takes
every name for nothing but a name.

Needs Debian's ``chromium`` and ``chromium-driver``, and Selenium (the extra ``test``); skipped where one is missing.
"""

import dataclasses
import itertools
import json
import shutil
from contextlib import contextmanager

import numpy as np
import pytest
from PIL import Image

from navfilter.io.write import labelled, write_text
from navfilter.playback.replay import replay
from navfilter.report.instrument import _tile
from navfilter.report.report import render_report
from navfilter.simulation.scenarios import simulate_scenario

webdriver = pytest.importorskip("selenium.webdriver", reason="selenium is not there: pip install selenium")
BROWSER, DRIVER = shutil.which("chromium"), shutil.which("chromedriver")
pytestmark = pytest.mark.skipif(
    not (BROWSER and DRIVER), reason="no chromium and chromedriver: apt-get install chromium chromium-driver"
)

#: Names that would do something if a page took them for HTML, for a script, or for a formula.
NASTY = '<img src=x onerror="window.hit=1">'
SENSOR = "gps $$\\frac{1}{2}$$ <b>bold</b> </script><script>window.hit=2</script>"
NOON_S = 1_767_268_800.0


@pytest.fixture(scope="module")
def report(tmp_path_factory):
    """A short mission under nasty names, that knows UTC."""
    vehicle, mission = simulate_scenario("reckoning", seed=1, duration_s=150.0)
    vehicle = dataclasses.replace(
        vehicle, sensors={SENSOR if name == "gps" else name: sensor for name, sensor in vehicle.sensors.items()}
    )
    streams = {SENSOR if name == "gps" else name: stream for name, stream in mission.streams.items()}
    mission = dataclasses.replace(
        mission, name=f"dive {NASTY}", streams=streams, notes=(f"gps: {NASTY}",), epoch_utc_s=NOON_S
    )
    tracks = labelled(replay(vehicle, mission, smooth=True))
    return write_text(render_report(tracks, mission), tmp_path_factory.mktemp("report") / "report.html")


def browser(width, scripts=True):
    options = webdriver.ChromeOptions()
    options.binary_location = BROWSER
    for argument in ("--headless=new", "--no-sandbox", "--disable-dev-shm-usage", "--disable-gpu"):
        options.add_argument(argument)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    driver = webdriver.Chrome(options=options, service=webdriver.ChromeService(DRIVER))
    # so high that every figure is in view
    size = {"width": width, "height": 12_000, "deviceScaleFactor": 1, "mobile": width < 600}
    driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
    driver.execute_cdp_cmd("Emulation.setScriptExecutionDisabled", {"value": not scripts})
    return driver


def wait(driver, script, seconds=60):
    """Until a script returns something true."""
    from selenium.webdriver.support.ui import WebDriverWait

    return WebDriverWait(driver, seconds).until(lambda it: it.execute_script(script))


#: Every figure that the page shows now is drawn.
ALL_DRAWN = """
const shown = [...document.querySelectorAll("figure.linked")].filter((each) => each.offsetParent !== null);
return shown.length > 0 && shown.every((each) => each.classList.contains("drawn"));
"""


@contextmanager
def wide(page):
    """A page in a wide window, all drawn."""
    driver = browser(1400)
    try:
        driver.get(page.as_uri())
        wait(driver, ALL_DRAWN)
        yield driver
    finally:
        driver.quit()


@pytest.fixture(scope="module")
def shown(report):
    with wide(report) as driver:
        yield driver


def ranges(driver):
    return driver.execute_script(
        "return Bokeh.documents.map((doc) => doc.get_model_by_name('time')).filter((range) => range)"
        ".map((range) => [range.start, range.end])"
    )


def drag(driver, figure, begin, end):
    """Drag over the first panel of a figure, from one share of its width to another."""
    from selenium.webdriver import ActionChains

    box = figure.rect
    x = [int(box["width"] * (share - 0.5)) for share in (begin, end)]
    y = 130 - box["height"] // 2
    ActionChains(driver).move_to_element_with_offset(figure, x[0], y).click_and_hold().move_by_offset(
        x[1] - x[0], 0
    ).release().perform()


def test_it_renders(shown):
    assert shown.execute_script("return document.querySelectorAll('figure.failed').length") == 0
    assert shown.execute_script("return Bokeh.documents.length") >= 6
    assert all(box.rect["height"] > 200 for box in shown.find_elements("css selector", "figure.drawn .live"))
    assert not shown.execute_script(
        "return [...document.querySelectorAll('figure.linked > img')].some((each) => each.offsetParent !== null)"
    )


def test_every_name_is_only_a_name(shown):
    assert shown.execute_script("return window.hit ?? null") is None
    assert shown.execute_script("return document.querySelectorAll('img[src=\"x\"], b').length") == 0
    assert shown.find_element("tag name", "h1").text == f"dive {NASTY}"
    options = shown.find_elements("css selector", "select.sensors option")
    assert SENSOR in [option.get_attribute("value") for option in options]


def test_a_zoom_in_one_figure_is_a_zoom_in_all(shown):
    before = ranges(shown)
    assert len(before) >= 4 and len({tuple(pair) for pair in before}) == 1
    over_time = shown.find_elements("css selector", ".live")[1]
    drag(shown, over_time, 0.4, 0.6)
    wait(shown, f"const r = Bokeh.documents[1].get_model_by_name('time'); return r.end - r.start < {0.5 * 150}")
    after = ranges(shown)
    begin, end = after[0]
    assert len({tuple(pair) for pair in after}) == 1 and before[0][0] < begin < end < before[0][1]
    utc = shown.execute_script("const r = Bokeh.documents[1].get_model_by_name('utc'); return [r.start, r.end]")
    assert utc == pytest.approx([1000.0 * (NOON_S + begin), 1000.0 * (NOON_S + end)])
    from selenium.webdriver import ActionChains

    ActionChains(shown).move_to_element(over_time).double_click().perform()
    wait(shown, f"const r = Bokeh.documents[1].get_model_by_name('time'); return r.end - r.start > {0.9 * 150}")
    assert ranges(shown) == before


def test_the_cursor_is_in_all_figures_and_on_the_track(shown):
    from selenium.webdriver import ActionChains

    ActionChains(shown).move_to_element(shown.find_elements("css selector", ".live")[1]).perform()
    said = wait(shown, "return document.getElementById('readout').textContent")
    assert "2026-01-01 12:0" in said and "depth" in said and "heading" in said
    spans = "return Bokeh.documents.flatMap((doc) => doc.roots().flatMap((root) => root.select('cursor')))"
    places = shown.execute_script(f"{spans}.map((span) => [span.visible, span.location])")
    assert len(places) > 10 and {tuple(place) for place in places} == {(True, places[0][1])}
    here = "return Bokeh.documents[0].roots()[0].select('here')[0].data_source.data.x.length"
    assert shown.execute_script(here) == 1


def test_a_legend_hides_a_run_everywhere(shown):
    visible = (
        "return Bokeh.documents.flatMap((doc) => doc.roots().flatMap((root) => root.select('smoothed')))"
        ".map((part) => part.visible)"
    )
    assert all(shown.execute_script(visible))
    key = next(key for key in shown.find_elements("css selector", ".key") if key.text == "smoothed")
    key.click()
    hidden = shown.execute_script(visible)
    assert len(hidden) > 5 and not any(hidden) and key.get_attribute("aria-pressed") == "false"
    key.click()
    assert all(shown.execute_script(visible))


@pytest.mark.parametrize("way", ["sd", "time", "run"])
def test_the_track_is_coloured_as_chosen(shown, way):
    shown.find_element("css selector", f"input[name=colouring][value={way}]").click()
    visible = shown.execute_script(
        "const root = Bokeh.documents[0].roots()[0];"
        "return [...root.references()].filter((part) => String(part.tags?.[0]).startsWith('colour '))"
        ".map((part) => [part.tags[0], part.visible])"
    )
    assert {tag for tag, on in visible if on} == {f"colour {way}"} and len(visible) >= 6


def test_the_menu_shows_one_sensor(shown):
    sections = shown.find_elements("css selector", "section[data-sensor]")
    names = [section.get_attribute("data-sensor") for section in sections]
    assert [section.is_displayed() for section in sections] == [True] + [False] * (len(names) - 1)
    link = shown.find_elements("css selector", "nav a[href^='#sensor-']")[-1]
    link.click()
    wait(shown, ALL_DRAWN)
    assert [section.is_displayed() for section in sections] == [False] * (len(names) - 1) + [True]
    assert shown.find_element("css selector", "select.sensors").get_attribute("value") == names[-1]


def test_nothing_is_said_on_the_console_and_nobody_is_asked(shown, report):
    """The last test in this window: after all that was done in it."""
    lines = [entry for entry in shown.get_log("browser") if entry["level"] != "INFO"]
    assert lines == []
    events = [json.loads(entry["message"])["message"] for entry in shown.get_log("performance")]
    asked = [e["params"]["request"]["url"] for e in events if e["method"] == "Network.requestWillBeSent"]
    assert {url.split("#")[0] for url in asked if not url.startswith(("data:", "blob:"))} == {report.as_uri()}


def test_it_fits_a_telephone(report):
    driver = browser(420)
    try:
        driver.get(report.as_uri())
        wait(driver, ALL_DRAWN)
        assert driver.execute_script("return document.documentElement.scrollWidth") <= 420
        assert driver.find_element("css selector", ".verdict").rect["y"] < 500
    finally:
        driver.quit()


def test_without_scripts_the_figures_for_print_are_there(report):
    driver = browser(1000, scripts=False)
    try:
        driver.get(report.as_uri())
        pictures = driver.find_elements("css selector", "figure > img")
        assert len(pictures) >= 8 and all(picture.is_displayed() for picture in pictures)
        assert not driver.find_elements("css selector", "figure.drawn")
        assert not any(place.is_displayed() for place in driver.find_elements("css selector", ".live, .choice"))
    finally:
        driver.quit()


@pytest.fixture(scope="module")
def overlaid(tmp_path_factory):
    """A report with another run beside it and a chart below it, in a wide window."""
    folder = tmp_path_factory.mktemp("overlaid")
    vehicle, mission = simulate_scenario("reckoning", seed=1, duration_s=150.0)
    tracks = labelled(replay(vehicle, mission, smooth=True))
    other = replay(vehicle.without("depth"), mission)
    zoom, place = 17, [float(np.degrees(values[0])) for values in (other.longitude, other.latitude)]
    for x, y in itertools.product(range(-2, 3), repeat=2):
        column, row = (int(part) + step for part, step in zip(_tile(*place, zoom), (x, y), strict=True))
        file = folder / "tiles" / str(zoom) / str(column) / f"{row}.png"
        file.parent.mkdir(parents=True, exist_ok=True)
        Image.new("RGB", (256, 256), (200, 220, 240)).save(file)
    page = render_report(tracks, mission, beside={"other": other}, tiles=folder / "tiles")
    report = write_text(page, folder / "report.html")
    with wide(report) as driver:
        yield driver


def test_another_run_and_a_chart_are_shown(overlaid):
    kinds = "return Bokeh.documents[0].roots()[0].select('{}').length"
    assert overlaid.execute_script(kinds.format("other")) and overlaid.execute_script(kinds.format("chart"))
    lines = "return Bokeh.documents[1].roots().flatMap((root) => root.select('other')).length"
    assert overlaid.execute_script(lines) >= 2
    labels = [key.text for key in overlaid.find_elements("css selector", ".key")]
    assert "other" in labels and "chart" in labels


def test_any_quantity_is_shown_against_any_other(overlaid):
    menus = overlaid.find_elements("css selector", "select.any")
    assert [menu.get_attribute("value") for menu in menus] == ["travelled", "rms"]
    overlaid.execute_script(
        "for (const [k, v] of [[0, 'heading'], [1, 'innovation gps north']]) {"
        "const menu = document.querySelectorAll('select.any')[k]; menu.value = v;"
        "menu.dispatchEvent(new Event('change')); }"
    )
    find = "Bokeh.documents.flatMap((doc) => doc.roots().flatMap((root) => root.select('any')))[0]"
    points = overlaid.execute_script(f"const d = {find}.data_source.data; return [[...d.x], [...d.y]]")
    assert len(points[0]) == len(points[1]) > 50 and max(points[0]) > 6.3 and max(map(abs, points[1])) < 10.0


def test_the_track_follows_a_zoom_in_time(overlaid):
    """To the part that is shown, and back."""
    edges = (
        "const r = Bokeh.documents[0].roots()[0];"
        "return ['east', 'north'].flatMap((n) => [r.select(n)[0].start, r.select(n)[0].end])"
    )
    marked = "return Bokeh.documents[0].roots()[0].select('zoomed')[0].data_source.data.x.length"
    before = overlaid.execute_script(edges)
    over_time = overlaid.find_elements("css selector", ".live")[1]
    drag(overlaid, over_time, 0.4, 0.5)
    wait(overlaid, f"{marked} > 10")
    wait(overlaid, f"const e = (() => {{ {edges} }})(); return e[1] - e[0] < {0.8 * (before[1] - before[0])}")
    after = overlaid.execute_script(edges)
    ratio = [(e[1] - e[0]) / (e[3] - e[2]) for e in (before, after)]
    assert ratio[1] == pytest.approx(ratio[0], rel=0.02)
    from selenium.webdriver import ActionChains

    ActionChains(overlaid).move_to_element(over_time).double_click().perform()
    wait(overlaid, f"{marked} === 0")
    assert overlaid.execute_script(edges) == pytest.approx(before, rel=0.01)
    assert [entry for entry in overlaid.get_log("browser") if entry["level"] != "INFO"] == []
