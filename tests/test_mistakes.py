"""Every mistake of the manual's table is noticed, by `check` or by the verdict, and the table says what they say."""

import re
from pathlib import Path
from typing import get_args

import file_mistakes
import mistakes_library as library
import pytest

from navfilter.check.finding import Code

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


def test_every_code_of_a_finding_is_explained_once():
    table = PAGE.read_text(encoding="utf-8").split("\n## Codes\n")[1]
    cells = re.findall(r"^\| (`.+?`) \| .+ \|$", table, flags=re.MULTILINE)
    told = [code for cell in cells for code in re.findall(r"`([\w-]+)`", cell)]
    assert sorted(told) == sorted(code for group in get_args(Code) for code in get_args(group))


def test_the_table_has_every_mistake_and_none_that_is_not():
    assert [row[0] for row in ROWS] == list(library.MISTAKES) and len(ROWS) >= 20


FILE_ROWS = re.findall(r"^\| ([^|]+?) \| ([^|]+?) \| (\d) \|$", PAGE.read_text(encoding="utf-8"), flags=re.MULTILINE)
READ_RIGHT = re.search(r"^Read right, without a word: (.*?)\.\n\n", PAGE.read_text(encoding="utf-8"), re.M | re.S)
READ_RIGHT = " ".join(READ_RIGHT.group(1).split()).split(", ")
FILES_SAID = {name: row[1:] for row in FILE_ROWS for name in row[0].split("; ")}


def stands_for(shown, said):
    """Whether what the page shows is what is said behind the name of the file; an ellipsis stands for some words."""
    said = re.sub(r"^(depth \(log\.csv\):|log\.csv:?) ", "", said)
    return re.fullmatch(".+".join(re.escape(words(part)) for part in shown.split("…")), words(said)) is not None


def test_an_ellipsis_stands_for_words_and_for_nothing_else():
    assert stands_for("no 4 … unit", "no 5 of them: unit") and stands_for("no …", "no unit")
    assert not stands_for("no … unit", "no unit is known") and not stands_for("no", "no unit")


@pytest.mark.parametrize("name", file_mistakes.FILES)
def test_no_number_of_a_file_is_wrong_without_a_word(tmp_path, name):
    told = file_mistakes.told(tmp_path, *file_mistakes.FILES[name])
    assert told.right or (told.code and told.said)
    if name in READ_RIGHT:
        assert told.right and not told.said and told.code == 0
        return
    said, code = FILES_SAID[name]
    assert stands_for(said, told.said) and told.code == int(code)


def test_the_table_has_every_file():
    assert list(FILES_SAID) == [name for name in file_mistakes.FILES if name in FILES_SAID]
    assert [name for name in file_mistakes.FILES if name not in FILES_SAID] == READ_RIGHT
    assert len(file_mistakes.FILES) >= 50
