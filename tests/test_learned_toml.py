"""vehicle_learned.toml keeps what its user wrote, and is the vehicle that learnt."""

import dataclasses

import numpy as np
import pytest

from navfilter.io import read_vehicle
from navfilter.io.toml_editing import write_learned
from navfilter.models.error_models import GaussMarkov, per_axis
from navfilter.models.learned_arma import learned_part, with_learned
from navfilter.timeseries.model import ArmaModel

MODEL = ArmaModel([-1.9, 0.95], [0.3], 0.001, 1e-4 * np.eye(3), 0.2, 3900.0, frozenset({"fallback"}))
OTHER = ArmaModel([-0.5], [], 0.002)
SLOW = GaussMarkov(sd=0.01, tau_s=60.0)
TWO = SLOW + GaussMarkov(sd=0.02, tau_s=400.0, order=2)

TEXT = """\
# the boat of 2026
name = "boat"

[drive]   # a tactical unit
type = "imu"
rate_hz = 100
gyro = {model = "white", density_deg_per_sqrt_h = 0.3}
accel = {model = "white", density_mg_per_sqrt_hz = 0.1}

[sensors.compass]
type = "heading"   # magnetic
rate_hz = 8
# found at the quay
error = COMPASS  # keep an eye on it
bias_sd_deg = 2.0

[sensors.dvl]
type = "body-velocity"
rate_hz = 4
error = DVL
lever_arm_b_m = [0.5, 0.0, 0.1]

[sensors.gps]
type = "position"
error = {model = "gauss-markov", sd = 3.0, tau_s = 60}
"""
PLAIN = '{model = "white", sd = 0.01}'
LEARNED = '{model = "learned-arma", prior = {model = "gauss-markov", sd_deg = 0.6, tau_s = 30}, window = 2000}'


def written(tmp_path, compass=LEARNED, dvl=PLAIN, adopt=None, frozen=False, without=(), slow=None):
    """The vehicle as learnt, the text of the file written for it."""
    source = tmp_path / "vehicle.toml"
    source.write_text(TEXT.replace("COMPASS", compass).replace("DVL", dvl))
    vehicle = read_vehicle(source).without(*without)
    errors = {}
    for name, models in (adopt or {"compass": (MODEL,)}).items():
        before = per_axis(vehicle.sensors[name].error, vehicle.sensors[name].axes, name)
        after = tuple(
            with_learned(b, dataclasses.replace(learned_part(b), model=m, frozen=frozen, slow=slow))
            for b, m in zip(before, models, strict=True)
        )
        errors[name] = after[0] if len(after) == 1 else after
    learnt = vehicle.with_error(**errors)
    path = write_learned(learnt, tmp_path / "vehicle_learned.toml", tmp_path, {"compass": "learnt on dive 7"})
    back = read_vehicle(path)
    for name, sensor in learnt.sensors.items():
        assert back.sensors[name] == sensor
    assert back.drive == learnt.drive
    return learnt, path.read_text()


@pytest.mark.parametrize("slow", [None, SLOW, TWO])
@pytest.mark.parametrize("frozen", [False, True])
def test_only_what_was_learnt_is_added(tmp_path, frozen, slow):
    _, text = written(tmp_path, frozen=frozen, slow=slow)
    before = TEXT.replace("COMPASS", LEARNED).replace("DVL", PLAIN).splitlines()
    after = text.splitlines()
    changed = [line for line in after if line not in before]
    assert changed[0] == "# learnt on dive 7" and len(changed) == 2 and len(after) == len(before) + 1
    assert changed[1].startswith(f"error = {LEARNED[:-1]}, adopted = {{ar = [") and changed[1].endswith(
        "  # keep an eye on it"
    )
    assert ("frozen = true" in changed[1]) == frozen
    assert changed[1].count("slow = ") == (slow is not None)


def test_what_was_learnt_before_is_replaced(tmp_path):
    """A second dive: model and slow part of the first one go, and so does a slow part that is no longer there."""
    _, text = written(tmp_path, slow=TWO)
    line = next(line for line in text.splitlines() if line.startswith('error = {model = "learned-arma"'))
    compass = line.removeprefix("error = ").removesuffix("  # keep an eye on it")
    _, again = written(tmp_path, compass=compass, slow=SLOW)
    assert again.count("slow = ") == 1 and again.count("adopted = ") == 1
    assert written(tmp_path, compass=compass)[1].count("slow = ") == 0


def test_a_second_dive_replaces_what_the_first_has_learnt(tmp_path):
    _, text = written(tmp_path, compass=LEARNED[:-1] + ", adopted = {ar = [-0.1], ma = [], sd = 1.0}}")
    assert text.count("adopted") == 1 and "-1.9" in text
    _, text = written(
        tmp_path, compass='{model = "learned-arma", adopted = {ar = [-0.1], ma = [], sd = 1.0}, window = 2000}'
    )
    assert text.count("adopted") == 1 and "-1.9" in text


def test_a_sum_over_several_lines_keeps_its_other_parts(tmp_path):
    _, text = written(
        tmp_path, compass='[\n  {model = "white", sd_deg = 0.1},  # the digits }\n  {model = "learned-arma"},\n]'
    )
    assert '{model = "white", sd_deg = 0.1},  # the digits }\n' in text and "adopted" in text


def test_axes_that_learnt_apart_become_tables_of_their_own(tmp_path):
    models = (MODEL, OTHER, OTHER)
    learnt, text = written(tmp_path, compass=PLAIN, dvl='{model = "learned-arma"}', adopt={"dvl": models})
    assert [part.model for part in map(learned_part, learnt.sensors["dvl"].error)] == list(models)
    assert 'error = {x = {model = "learned-arma", adopted' in text and "# the boat of 2026" in text


def test_sensors_that_the_run_went_without_stay(tmp_path):
    _, text = written(tmp_path, without=("gps",))
    assert "[sensors.gps]" in text


@pytest.mark.parametrize(
    "unusual", ['{prior = {model = "white", sd = 0.1}, model = "learned-arma"}', '{"model" = "learned-arma"}']
)
def test_an_unusual_layout_is_kept(tmp_path, unusual):
    """`written` has read it back."""
    _, text = written(tmp_path, compass=unusual)
    assert "adopted" in text and "# the boat of 2026" in text and unusual[:-1] in text


def test_a_file_without_the_place_is_written_anew(tmp_path):
    learnt, _ = written(tmp_path)
    other = tmp_path / "other.toml"
    other.write_text(TEXT.replace("COMPASS", LEARNED).replace("DVL", PLAIN).replace("sensors.compass", "sensors.other"))
    text = write_learned(learnt, tmp_path / "new.toml", other).read_text()
    assert read_vehicle(tmp_path / "new.toml") == learnt and "# the boat of 2026" not in text


def test_without_a_file_all_is_written_anew(tmp_path):
    learnt, _ = written(tmp_path)
    assert read_vehicle(write_learned(learnt, tmp_path / "new.toml")) == learnt
