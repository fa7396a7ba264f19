"""The recipes work when followed literally: every block becomes the file it names, every script runs in its order."""

import contextlib
import re
import runpy
import sys
from pathlib import Path

import numpy as np
import pytest

PAGE = (Path(__file__).parent.parent / "docs" / "pages" / "recipes.md").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def followed(tmp_path_factory):
    """Names that each script left behind, by its file."""
    folder = tmp_path_factory.mktemp("recipes")
    blocks = re.findall(r"^```(\w+)\n# (\S+)\n(.*?)^```", PAGE, flags=re.MULTILINE | re.DOTALL)
    assert len(blocks) == PAGE.count("\n```") // 2, "every block begins with the name of its file"
    found = {}
    with contextlib.chdir(folder), pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(folder))
        for _, name, text in blocks:
            Path(name).write_text(text, encoding="utf-8")
        for language, name, _ in blocks:
            stem = name.removesuffix(".py")
            if language == "python" and not re.search(rf"^(import|from) {stem}\b", PAGE, flags=re.MULTILINE):
                found[name] = runpy.run_path(name)
        yield found
        for _, name, _ in blocks:
            sys.modules.pop(name.removesuffix(".py"), None)


def test_the_sensor_corrects_as_well_as_the_filter_says(followed):
    residuals = followed["dive.py"]["track"].residuals["altimeter"]
    assert len(residuals.time_s) > 230 and residuals.used.all()
    # 240 readings: the mean of chi-square scatters by sqrt(2 / 240) = 0.09
    assert abs(np.nanmean(residuals.nis) - 1.0) < 0.3


def test_the_error_model_is_what_the_sensor_errs_by(followed):
    after = {}
    for name, run in followed["compare.py"]["runs"].items():
        residuals = run.residuals["altimeter"]
        innovation = residuals.value[:, 0] / residuals.sd[:, 0]
        after[name] = float(np.corrcoef(innovation[1:], innovation[:-1])[0, 1])
    # 240 readings: the correlation of white ones scatters by 1 / sqrt(240) = 0.06
    assert abs(after["swell"]) < 0.25 and after["white"] > 0.5


def test_the_rule_for_R_makes_the_dvl_surer_of_nothing(followed):
    described, huber = followed["huber.py"]["runs"].values()
    assert described.residuals["dvl"].used.sum() == huber.residuals["dvl"].used.sum() > 100
    sd = [float(run.residuals["dvl"].sd[run.residuals["dvl"].used].mean()) for run in (described, huber)]
    assert sd[1] > 1.001 * sd[0]


def test_the_file_formats_give_the_same_readings(followed):
    names = followed["convert.py"]
    simulated = names["mission"].streams["altimeter"].value
    np.testing.assert_allclose(
        names["recorded"].streams["altimeter"].value, simulated, atol=0.0051
    )  # two digits in the file
    np.testing.assert_allclose(names["table"].streams["altimeter"].value, simulated, rtol=1e-12)
    assert names["track"].residuals["altimeter"].used.sum() > 110
