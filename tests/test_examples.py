"""The examples of the manual run as they are written, from the raw file to the result, and print what they say."""

import contextlib
import math
import re
import shlex
import shutil
from pathlib import Path

import pytest

from navfilter.commands.cli import main

FOLDER = Path(__file__).parent.parent / "docs" / "pages" / "examples"
PAGES = sorted(page for page in FOLDER.glob("*.md") if page.stem != "notebook")
#: Page -> recording (may be a pattern), and what the page calls it where that is another name.
RAW = {
    "auv-dvl": ("snapir-auv-1hz/*_trajectory1.csv*", ""),
    "bluerov": ("logs/ardupilot/ardusub_small.tlog", ""),
    "ros2-dvl": ("sonia-auv-pool/20160305_CIRCLE", "pool_circle"),
    "yacht": ("yacht-irene-1hz/flensburg_20130803_NMEA0004.TXT.xz", "flensburg.TXT.xz"),
    "glider": ("glider-slocum-ru28/ru28_*_dbd.dat.xz", ""),
    "noise-sheet": ("imu-adis16405-static/adis16405_unit1.npz", "adis16405.npz"),
}
#: Numbers agree with those of the page to this; processor times are another machine's.
RELATIVE, DIGIT = 0.02, 1.01
#: What `navfilter replay` ends with where a page says "exit code 3": the track is not judged, by design.
NOT_JUDGED = 3
#: Page -> what the raw file is read with, and the extra of navfilter that brings it.
READERS = {"bluerov": ("pymavlink", "ardupilot"), "ros2-dvl": ("rosbags", "ros"), "yacht": ("pynmeagps", "nmea")}
NUMBER = re.compile(r"[-+]?\d+\.?\d*(?:e[-+]?\d+)?")
#: A sample in place of a raw file or a folder of its own is written by the test.
MADE = {"ros2-dvl"}


def blocks(page, language):
    text = page.read_text(encoding="utf-8")
    found = re.findall(r"^```(\w*)\n(.*?)^```", text, flags=re.MULTILINE | re.DOTALL)
    return [block for kind, block in found if kind == language]


def commands(page):
    return [line for block in blocks(page, "sh") for line in block.splitlines() if line.startswith("navfilter ")]


def place(page, data_file, recording):
    """The raw file, in the current folder under the name that the page calls it by, and files that the page has whole:
    their first line is their name.
    """
    for block in blocks(page, "toml"):
        if named := re.match(r"# ([\w/]+\.toml)\n", block):
            path = Path(named.group(1))
            path.parent.mkdir(exist_ok=True)
            path.write_text(block, encoding="utf-8")
    if page.stem in READERS:
        package, extra = READERS[page.stem]
        pytest.importorskip(package, reason=f'{package} is not installed: pip install "navfilter[{extra}]"')
    name, called = RAW[page.stem]
    if page.stem in MADE:
        from pool_bag import write_bag

        import navfilter as nf

        write_bag(Path(called), nf.read_mission(recording(name)))
        return
    folder, pattern = name.rsplit("/", 1)
    found = sorted(data_file(folder).glob(pattern))
    assert found, name
    for path in found:
        shutil.copy(path, called or path.name)


def agrees(said, shown):
    """Whether two lines have the same words and, but for the last digit or two per cent, the same numbers."""
    words, others = (" ".join(NUMBER.sub("#", line).split()) for line in (said, shown))
    if words != others:
        return False
    if "processor time" in shown:
        said, shown = (re.sub(r"[\d.]+ s of processor time", "", line) for line in (said, shown))
    return all(
        math.isclose(float(a), float(b), rel_tol=RELATIVE, abs_tol=DIGIT * 10.0 ** -len(b.partition(".")[2]))
        for a, b in zip(NUMBER.findall(said), NUMBER.findall(shown), strict=True)
    )


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_a_page_is_at_most_three_commands_and_no_code(page):
    assert 1 <= len(commands(page)) <= 3
    assert not blocks(page, "python") and RAW[page.stem]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_a_page_works_when_copied_and_prints_what_it_says(page, data_file, recording, tmp_path, capsys):
    with contextlib.chdir(tmp_path):
        place(page, data_file, recording)
        capsys.readouterr()
        says_so = f"exit code {NOT_JUDGED}" in " ".join(page.read_text(encoding="utf-8").split())
        for command in commands(page):
            code = NOT_JUDGED if says_so and command.startswith("navfilter replay ") else 0
            assert main(shlex.split(command)[1:]) == code, (command, capsys.readouterr().err)
    said = capsys.readouterr().out.splitlines()
    shown = [line for block in blocks(page, "") for line in block.splitlines() if line.strip()]
    assert len(shown) >= 5
    missing = [line for line in shown if not any(agrees(one, line) for one in said)]
    assert missing == []


def test_two_lines_agree_by_their_words_and_numbers():
    line = "gps at 3758 s: 633.30 m off, 19 m travelled, 0.4 s of processor time"
    assert agrees(line.replace("633.30", "633.31").replace("0.4 s", "9.9 s"), line)
    assert not agrees(line.replace("633.30", "733.30"), line) and not agrees(line.replace("off", "on"), line)
    assert agrees("a   b  2e-07", "a b 2.01e-07") and not agrees("a 12", "a 14")


# --- the notebook ---------------------------------------------------------------------------------------------------


def test_the_notebook_runs_and_is_kept_without_output(tmp_path):
    nbformat = pytest.importorskip("nbformat", reason='nbformat is not installed: pip install "navfilter[test]"')
    nbclient = pytest.importorskip("nbclient", reason='nbclient is not installed: pip install "navfilter[test]"')
    pytest.importorskip("ipykernel", reason='ipykernel is not installed: pip install "navfilter[test]"')
    notebook = nbformat.read(FOLDER / "dive.ipynb", 4)
    code = [cell for cell in notebook.cells if cell.cell_type == "code"]
    assert all(cell.outputs == [] and cell.execution_count is None for cell in code)
    resources = {"metadata": {"path": str(tmp_path)}}
    nbclient.NotebookClient(notebook, timeout=600, kernel_name="python3", resources=resources).execute()
    outputs = [output for cell in code for output in cell.outputs]
    assert sum("image/png" in output.get("data", {}) for output in outputs) == 2
    said = "".join(output.get("text", "") for output in outputs)
    described, white = (float(cell) for cell in re.findall(r"NEES heading +([\d.]+) +([\d.]+)", said)[0])
    # what the last cell says: white noise of the same size is far too sure of the heading
    assert described < 3.0 and white > 30.0
