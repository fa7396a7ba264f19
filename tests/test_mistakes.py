"""Every mistake of the manual's table is noticed, by `check` or by the verdict, and the table says what they say."""

import re
from pathlib import Path

import file_mistakes
import mistakes_library as library
import pytest

PAGE = Path(__file__).parent.parent / "docs" / "pages" / "mistakes.md"
ROWS = re.findall(r"^\| ([^|]+?) \| (.+?) \| (\d) \| (.+?) \|$", PAGE.read_text(encoding="utf-8"), flags=re.MULTILINE)


@pytest.fixture(scope="module")
def dive():
    return library.sound()


def words(text):
    """Without its numbers: they need not agree to the last digit."""
    return " ".join(re.sub(r"[-+]?\d[\d.e+-]*", "#", text).split())


def shown(findings):
    where = f"{findings[0].stream}: " if findings and findings[0].stream else ""
    return words(f"{where}{findings[0].text}") if findings else "-"


def test_the_sound_dive_raises_no_alarm(dive):
    told = library.told(*dive)
    assert told.check == () and not told.noticed_by_verdict and told.code == 0


@pytest.mark.parametrize("name", library.MISTAKES)
def test_a_mistake_is_noticed_as_the_manual_says(dive, name):
    told = library.told(*library.MISTAKES[name](*dive))
    assert told.noticed_by_check or told.noticed_by_verdict
    check, code, verdict = {row[0]: row[1:] for row in ROWS}[name]
    assert words(check) == shown(told.check)
    assert told.code == int(code)
    # which of several doubts comes first, and in which words, depends on how far the spoiled filter went astray
    assert (verdict == "-") == (not told.noticed_by_verdict)


def test_the_table_has_every_mistake_and_none_that_is_not():
    assert [row[0] for row in ROWS] == list(library.MISTAKES) and len(ROWS) >= 20


FILE_ROWS = re.findall(r"^\| ([^|]+?) \| ([^|]+?) \| (\d) \|$", PAGE.read_text(encoding="utf-8"), flags=re.MULTILINE)


@pytest.mark.parametrize("name", file_mistakes.FILES)
def test_no_number_of_a_file_is_wrong_without_a_word(tmp_path, name):
    told = file_mistakes.told(tmp_path, *file_mistakes.FILES[name])
    assert told.right or (told.code and told.said)
    said, code = {row[0]: row[1:] for row in FILE_ROWS}[name]
    assert (words(said), int(code)) == (words(told.said or "read right"), told.code)


def test_the_table_has_every_file():
    assert [row[0] for row in FILE_ROWS] == list(file_mistakes.FILES) and len(FILE_ROWS) >= 40
