"""The figures of the README and the manual: `python docs/figures.py FOLDER [--make]`.

FOLDER holds what the commands of the page "Post-processing, step by step" write; --make runs them there before. Where
they are there, sections of their reports are photographed as a browser shows them (chromium, chromedriver and
Selenium). Where ``navfilter demo`` has written there, the figure of the README is taken from its comparison.
"""

import argparse
import re
import shutil
import subprocess
import sys
from pathlib import Path
from urllib.parse import unquote

from PIL import Image

HERE = Path(__file__).parent
PAGE = HERE / "pages" / "post-processing.md"
#: By file: which run, the title of its section, and what is chosen before.
SHOTS = {
    "desk-track.png": ("second", "Track", ""),
    "desk-backward.png": ("first", "Forward and backward", ""),
    "desk-drive.png": ("first", "accel", "choose('select.sensors', 'accel');"),
    "desk-any.png": (
        "first",
        "Any against any",
        "choose('select.any[data-axis=x]', 'heading'); choose('select.any[data-axis=y]', 'innovation compass');",
    ),
}
WIDTH, COLOURS = 900, 64
CHOOSE = """
function choose(menu, value) {
  const found = document.querySelector(menu);
  if (![...found.options].some((option) => option.value === value)) throw `no ${value} in ${menu}`;
  found.value = value; found.dispatchEvent(new Event("change"));
}
"""
DRAWN = """
const shown = [...document.querySelectorAll("figure.linked")].filter((each) => each.offsetParent !== null);
return shown.length > 0 && shown.every((each) => each.classList.contains("drawn"));
"""


def commands() -> list[str]:
    """Those of the page, in their order."""
    blocks = re.findall(r"```sh\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    return [line for block in blocks for line in block.splitlines() if line.startswith("navfilter ")]


def make(folder: Path) -> None:
    """Run them in a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    for command in commands():
        if subprocess.run([sys.executable, "-m", *command.split()], cwd=folder).returncode not in (0, 1, 3):
            raise SystemExit(f"{command}: failed")  # a verdict (1, 3: not judged) has a code of its own


def browser():
    """A window as high as any report."""
    from selenium import webdriver

    options = webdriver.ChromeOptions()
    options.binary_location = shutil.which("chromium")
    for argument in ("--headless=new", "--no-sandbox", "--disable-dev-shm-usage", "--disable-gpu"):
        options.add_argument(argument)
    driver = webdriver.Chrome(options=options, service=webdriver.ChromeService(shutil.which("chromedriver")))
    size = {"width": WIDTH, "height": 12_000, "deviceScaleFactor": 1, "mobile": False}
    driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
    return driver


def photograph(folder: Path) -> None:
    """All of `SHOTS`, in few colours."""
    from selenium.webdriver.support.ui import WebDriverWait

    driver = browser()
    try:
        for name, (run, title, chosen) in SHOTS.items():
            driver.get((folder / run / "report.html").resolve().as_uri())
            for script in (CHOOSE + chosen, ""):
                WebDriverWait(driver, 60).until(lambda it: it.execute_script(DRAWN))
                driver.execute_script(script)
            figure = driver.find_element("xpath", f"//section[h2[normalize-space()='{title}']]//figure")
            figure.screenshot(str(HERE / "pages" / name))
            with Image.open(HERE / "pages" / name) as picture:
                few = picture.convert("RGB").quantize(COLOURS, dither=Image.Dither.NONE)
            few.save(HERE / "pages" / name, optimize=True)
            print(f"{name}: {(HERE / 'pages' / name).stat().st_size} bytes")
    finally:
        driver.quit()


def readme(page: Path) -> None:
    """The figure of the README, as the demonstration drew it."""
    section = page.read_text(encoding="utf-8").split("<h2>Error against 1 sigma</h2>")[1]
    drawn = re.search(r"data:image/svg\+xml,([^\"]+)", section).group(1)
    (HERE / "demo.svg").write_text(unquote(drawn.replace("&amp;", "&")), encoding="utf-8")
    print(f"demo.svg: {(HERE / 'demo.svg').stat().st_size} bytes")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, metavar="FOLDER")
    parser.add_argument("--make", action="store_true", help="run the commands of the page in it first")
    options = parser.parse_args()
    if options.make:
        make(options.folder)
    if (options.folder / "navfilter-demo" / "comparison" / "report.html").exists():
        readme(options.folder / "navfilter-demo" / "comparison" / "report.html")
    if all((options.folder / run / "report.html").exists() for run, *_ in SHOTS.values()):
        photograph(options.folder)
