"""Campaigns slot by slot: what is scored, what it is compared with, and the bars for what was learnt."""

import importlib
import json
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import navfilter as nf
from navfilter.commands.cli import main
from navfilter.evaluation.baselines import rivals
from navfilter.evaluation.montecarlo.campaign import (
    Campaign,
    Results,
    SlotRow,
    run_campaign,
    run_seed,
    slot_rows,
    slot_table,
    table,
    write_tables,
)
from navfilter.evaluation.montecarlo.slots import SLOT_SCORES, slot_figures, slots
from navfilter.playback.replay import replay_heard, residual_series

SMALL = Campaign("compass-slow-2min", duration_s=150.0, score_from_s=40.0, imu_rate_hz=20.0)
HEADING, ANEES = SLOT_SCORES.index("heading_rms_deg"), SLOT_SCORES.index("anees_heading")
MODELS, SEEDS = ("arma", "oracle", "gm1-fitted", "vehicle"), (1, 2)


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    folder = tmp_path_factory.mktemp("slots")
    return folder, run_campaign(SMALL, SEEDS, MODELS, folder)


# ------------------------------------------------------------------------------------- slots


@pytest.mark.parametrize(
    ("duration_s", "found"),
    [
        (1800.0, ((60.0, 120.0), (120.0, 520.0), (520.0, 1200.0), (1200.0, 1800.0))),
        (300.0, ((60.0, 120.0), (120.0, 300.0))),
        (520.0, ((60.0, 120.0), (120.0, 520.0))),
        (60.0, ()),
        (2700.0, ((60.0, 120.0), (120.0, 520.0), (520.0, 1200.0), (1200.0, 1800.0), (1800.0, 2700.0))),
    ],
)
def test_a_mission_is_cut_where_it_ends(duration_s, found):
    assert slots(duration_s) == found


def test_a_change_cuts_too_and_two_minutes_after_it_belong_to_nobody():
    campaign = Campaign("compass-triples", imu_rate_hz=20.0)
    assert campaign.slots == slots(2700.0, 900.0) and (900.0, 1020.0) in campaign.slots
    assert all(a[1] == b[0] for a, b in zip(campaign.slots, campaign.slots[1:], strict=False))


def test_figures_of_a_slot_are_those_of_its_rows(small):
    mission, staged = SMALL.staged.mission(1), SMALL.staged
    track = nf.replay(staged.vehicle, mission, output_rate_hz=1.0)
    errors = track.errors(mission.truth)
    nees = track.nees(errors)
    found = slot_figures(track, errors, nees, SMALL.slots)
    assert np.array_equal(found, small[1].slots[MODELS.index("vehicle"), 0, 0])
    rows = (track.time_s >= 60.0) & (track.time_s < 120.0)
    assert rows.sum() == 60
    told = track.summary(mission.truth, ((60.0, 119.5),))
    first = dict(zip(SLOT_SCORES, found[0], strict=True))
    assert first["heading_rms_deg"] == pytest.approx(told["heading_rms_deg"], rel=1e-12)
    assert first["position_rms_m"] == pytest.approx(told["position_rms_m"], rel=1e-12)
    assert first["anees_heading"] == pytest.approx(told["nees_heading"], rel=1e-12)
    assert first["down_rms_m"] == pytest.approx(np.sqrt(np.mean(errors.position_n[rows, 2] ** 2)), rel=1e-12)
    # a tenth of the standard deviation: the same errors, most of them beyond three of it, NEES a hundredfold
    sure = replace(track, covariance=0.01 * track.covariance)
    other = dict(zip(SLOT_SCORES, slot_figures(sure, errors, sure.nees(errors), SMALL.slots)[0], strict=True))
    assert other["anees_heading"] == pytest.approx(100.0 * first["anees_heading"])
    for name, z in (
        ("heading", np.sqrt(nees["heading"])),
        ("position", np.abs(errors.position_n) / np.sqrt(np.diagonal(track.covariance, axis1=1, axis2=2))[:, :3]),
    ):
        share = np.mean(10.0 * z[rows] > 3.0)
        assert other[f"beyond_{name}"] == pytest.approx(share) and share > 0.1


# ------------------------------------------------------------------------------------- figures and ratios


def made(values, models=("arma", "oracle"), campaign=SMALL):
    """Results of which only the slots are asked for: values (models, runs, slots, figures), forward."""
    values = np.asarray(values, dtype=float)
    both = np.full((len(models), 2, *values.shape[1:]), np.nan)
    both[:, 0] = values
    n = values.shape[1]
    return Results(
        replace(campaign, smooth=False), models, np.arange(n), np.empty(0), both, np.empty(0), np.empty(0), np.empty(0)
    )


def test_ratios_are_of_root_mean_squares_and_of_means():
    values = np.ones((2, 2, 2, len(SLOT_SCORES)))
    values[0, :, :, HEADING] = [[3.0, 3.0], [4.0, 4.0]]  # heading rms of two runs
    values[0, :, :, ANEES] = [[1.0, 1.0], [5.0, 5.0]]  # ANEES of the heading
    rows = {(r.begin_s, r.quantity, r.reference): r for r in slot_rows(made(values)) if r.model == "arma"}
    assert rows[60.0, "heading_rms_deg", "oracle"].value == pytest.approx(np.sqrt(12.5))
    assert rows[60.0, "anees_heading", "oracle"].value == pytest.approx(3.0)
    assert rows[60.0, "anees_heading", ""].value == pytest.approx(3.0) and rows[60.0, "anees_heading", ""].runs == 2


def test_all_slots_together_are_weighted_by_their_length():
    values = np.ones((1, 1, 2, len(SLOT_SCORES)))
    values[0, 0, :, HEADING], values[0, 0, :, SLOT_SCORES.index("anees_position")] = (1.0, 3.0), (2.0, 8.0)
    rows = {(r.begin_s, r.end_s, r.quantity): r.value for r in slot_rows(made(values, ("arma",)))}
    assert rows[60.0, 150.0, "heading_rms_deg"] == pytest.approx(np.sqrt((60.0 * 1.0 + 30.0 * 9.0) / 90.0))
    assert rows[60.0, 150.0, "anees_position"] == pytest.approx((60.0 * 2.0 + 30.0 * 8.0) / 90.0)
    values[0, 0, 1] = np.nan
    rows = {(r.begin_s, r.end_s, r.quantity): r.value for r in slot_rows(made(values, ("arma",)))}
    assert rows[60.0, 150.0, "anees_position"] == pytest.approx(2.0)


def test_a_mission_too_short_for_a_slot_says_nothing(tmp_path):
    campaign = Campaign("compass-slow-2min", duration_s=50.0, imu_rate_hz=20.0, smooth=False)
    results = run_campaign(campaign, (1,), ("vehicle",), tmp_path)
    assert slot_rows(results) == [] and "by slots" not in table(results)


def test_tables_and_files_hold_slots(small, tmp_path):
    results = small[1]
    text = table(results)
    for words in (
        "heading by slots, forward",
        "position by slots, smoothed",
        "120-150 s",
        "/ gm1-fitted",
    ):
        assert words in text, words
    assert max(map(len, text.splitlines())) <= 180
    write_tables(results, tmp_path)
    content = json.loads((tmp_path / "results.json").read_text())
    assert (
        len(content["slots"]) == len(slot_rows(results)) == len((tmp_path / "slots.csv").read_text().splitlines()) - 1
    )
    with np.load(tmp_path / "runs.npz") as file:
        assert np.array_equal(file["slots"], results.slots, equal_nan=True) and file["slot_times_s"].tolist() == [
            [60.0, 120.0],
            [120.0, 150.0],
        ]


def test_what_was_not_run_is_no_column(small):
    few = replace(small[1], models=MODELS[:2], slots=small[1].slots[:2], scores=small[1].scores[:2])
    assert "/ gm1-fitted" not in slot_table(few, slot_rows(few))


# ------------------------------------------------------------------------------------- bars

sys.path.append(str(Path(__file__).parent.parent / "benchmarks"))
judging = importlib.import_module("honest_bars")
bars, Bar = judging.bars, judging.Bar


def judged(name, **more):
    """The bars of a campaign by (begin, quantity, reference), all figures being one."""
    campaign = Campaign(name, imu_rate_hz=20.0, smooth=False, **more)
    models = MODELS if campaign.staged.oracle is not None else ("arma", "gm1-fitted", "vehicle")
    results = made(np.ones((len(models), 2, len(campaign.slots), len(SLOT_SCORES))), models, campaign)
    return {(b.begin_s, b.end_s, b.quantity, b.reference): b for b in bars(campaign, slot_rows(results))}


def limits(found, begin_s, quantity, reference):
    return next(((b.least, b.most) for k, b in found.items() if (k[0], *k[2:]) == (begin_s, quantity, reference)), None)


def test_bars_by_slot_and_gyro():
    """What was agreed, each number once more."""
    found = judged("compass-slow-10min")
    assert limits(found, 60.0, "anees_heading", "oracle") == (0.0, 2.5)
    assert limits(found, 60.0, "beyond_heading", "") is None
    for begin_s in (120.0, 520.0, 1200.0):
        assert limits(found, begin_s, "anees_heading", "oracle") == limits(found, begin_s, "anees_position", "oracle")
        assert limits(found, begin_s, "anees_heading", "oracle") == (0.5, 1.6)
        assert limits(found, begin_s, "beyond_heading", "") == (0.0, 0.015)
        assert limits(found, begin_s, "position_rms_m", "oracle") == (0.0, 1.05)
    assert limits(found, 120.0, "heading_rms_deg", "oracle") == (0.0, 1.15)
    assert limits(found, 520.0, "heading_rms_deg", "oracle") == (0.0, 1.06)
    assert limits(found, 120.0, "heading_rms_deg", "gm1-fitted") is None
    assert limits(found, 520.0, "heading_rms_deg", "gm1-fitted") == (0.0, 1.02)
    # better means better: what is the same has learnt nothing
    least, most = limits(found, 520.0, "heading_rms_deg", "vehicle")
    assert least == 0.0 and 1.0 - 1e-15 < most < 1.0
    assert not next(bar.met for key, bar in found.items() if key[3] == "vehicle")
    assert limits(judged("compass-slow-10min", gyro="mems"), 120.0, "anees_heading", "oracle") == (0.3, 1.6)
    # a description that is about right need not be beaten; for other sensors it is the place that counts
    assert limits(judged("compass-slow-2min"), 520.0, "heading_rms_deg", "vehicle") is None
    assert limits(judged("dvl-slow"), 520.0, "position_rms_m", "vehicle") == (least, most)
    depth = judged("depth-slow")
    assert limits(depth, 520.0, "down_rms_m", "vehicle") == (least, most)
    assert limits(depth, 520.0, "down_rms_m", "oracle") == limits(depth, 520.0, "position_rms_m", "oracle")


def test_where_the_truth_is_white_accuracy_is_judged_and_modesty_is_not():
    found = judged("compass-white")
    assert limits(found, 120.0, "heading_rms_deg", "oracle") == limits(found, 520.0, "position_rms_m", "oracle")
    assert limits(found, 120.0, "heading_rms_deg", "oracle") == (0.0, 1.03)
    assert not any(quantity.startswith("anees") for _, _, quantity, _ in found)


def test_bars_after_a_change():
    found = judged("compass-triples")
    assert {(b, e) for b, e, q, _ in found if q == "anees_heading"} == {
        (1020.0, 1200.0), (1200.0, 1800.0), (1800.0, 2700.0)
    }  # fmt: skip
    assert limits(found, 1020.0, "anees_heading", "") == (0.5, 2.0)
    whole = found[60.0, 2700.0, "heading_rms_deg", "gm1-fitted"]
    assert (whole.least, whole.most) == (0.0, 1.0) and whole.met


def test_where_a_figure_has_to_lie():
    good = Bar("arma", "forward", 120.0, 520.0, "anees_heading", "oracle", 1.6, 1.2, 2.0, 50, 0.5, 1.6)
    share = Bar("arma", "forward", 120.0, 520.0, "beyond_heading", "", 0.02, np.nan, np.nan, 50, 0.0, 0.015)
    assert good.met and not replace(good, value=1.61).met and not replace(good, value=0.49).met and not share.met


def test_a_figure_that_is_missing_is_no_bar():
    row = SlotRow("arma", "forward", 60.0, 120.0, "anees_heading", "oracle", np.nan, np.nan, np.nan, 0)
    assert bars(SMALL, [row]) == [] and bars(SMALL, [replace(row, model="vehicle", value=1.0)]) == []


# ------------------------------------------------------------------------------------- nothing that is not asked for


def test_one_run_gives_the_track_and_the_series():
    staged = SMALL.staged
    mission = staged.mission(2)
    track, heard = replay_heard(staged.vehicle, mission, ("compass",), output_rate_hz=1.0)
    plain, series = (
        nf.replay(staged.vehicle, mission, output_rate_hz=1.0),
        residual_series(staged.vehicle, mission, ("compass",)),
    )
    assert np.array_equal(track.covariance, plain.covariance) and np.array_equal(track.latitude, plain.latitude)
    assert np.array_equal(heard["compass"][0].value, series["compass"][0].value, equal_nan=True)
    fitted = rivals(("gm1-fitted",), staged.vehicle, mission, sensors=("compass",))
    assert rivals(("gm1-fitted",), staged.vehicle, mission, sensors=("compass",), series=heard) == fitted


def test_a_vehicle_that_learns_keeps_what_it_hears_for_itself():
    staged = SMALL.staged
    learning = staged.vehicle.with_error(compass=nf.LearnedArma())
    with pytest.raises(ValueError, match="learns"):
        replay_heard(learning, staged.mission(1), ("compass",))


def test_only_what_is_asked_for_is_run(monkeypatch):
    from navfilter.evaluation.montecarlo import campaign as campaigns

    ran = []

    def counted(vehicle, *arguments, **how):
        ran.append(vehicle)
        return nf.replay(vehicle, *arguments, **how)

    monkeypatch.setattr(campaigns, "replay", counted)
    monkeypatch.setattr("navfilter.evaluation.baselines.replay", counted)
    monkeypatch.setattr("navfilter.evaluation.baselines.residual_series", lambda *_: pytest.fail("nothing is fitted"))
    lean = replace(SMALL, smooth=False)
    assert list(run_seed(lean, 1, ("arma", "vehicle"))) == ["arma", "vehicle"] and len(ran) == 2
    # the fit takes its series from the run of the vehicle as described
    assert list(run_seed(lean, 1, ("gm1-fitted", "vehicle"))) == ["gm1-fitted", "vehicle"] and len(ran) == 3


def test_the_command_by_its_other_names(monkeypatch, tmp_path, capsys):
    import contextlib

    from navfilter.evaluation.montecarlo import workers

    monkeypatch.setattr(workers, "process_pool", lambda count: contextlib.nullcontext(None))
    how = ["montecarlo", "compass-slow-2min", "--seeds", "1", "--first-seed", "2", "--rivals", "vehicle"]
    how += ["--duration", "100", "--imu-rate", "20", "--no-smooth", "--no-figures", "--out", str(tmp_path)]
    assert main(how) == 0 and "heading by slots, forward" in capsys.readouterr().out
    assert [path.name for path in (tmp_path / "runs" / "vehicle").iterdir()] == ["00000002.npz"]
    assert not list(tmp_path.glob("*.png"))
    assert main([*how, "--scenario", "compass-gm2"]) == 2 and "one scenario" in capsys.readouterr().err
