"""Campaigns: the same numbers whatever runs them, continued where they were stopped, and figures that say what they
should.
"""

import contextlib
import csv
import json
import os
import signal
import subprocess
import sys
import threading
import time
from concurrent.futures import Executor, Future
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from navfilter.commands.cli import main
from navfilter.evaluation.montecarlo import campaign as campaigns
from navfilter.evaluation.montecarlo import workers
from navfilter.evaluation.montecarlo.campaign import (
    Campaign,
    Store,
    mean_interval,
    ratio_interval,
    rms_interval,
    rows,
    run_campaign,
    run_seed,
    share_interval,
    table,
    write_tables,
)
from navfilter.evaluation.montecarlo.figures import write_figures
from navfilter.evaluation.montecarlo.scores import CURVES, SCORES
from navfilter.evaluation.montecarlo.workers import cluster, process_pool
from navfilter.foundation.chi_square import chi_square_limit, chi_square_range

SMALL = Campaign("compass-gm1-white", duration_s=100.0, score_from_s=40.0, imu_rate_hz=20.0)
MODELS, SEEDS = ("vehicle", "gm1-fitted", "oracle"), (3, 4, 5)


@pytest.fixture
def in_process(monkeypatch):
    """The command's runs in this process: what a pool does is tested elsewhere, and every worker takes seconds to
    start.
    """
    monkeypatch.setattr(workers, "process_pool", lambda workers: contextlib.nullcontext(Now()))


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    """Nine runs of 100 s, in this process: (folder, results)."""
    folder = tmp_path_factory.mktemp("small")
    return folder, run_campaign(SMALL, SEEDS, MODELS, folder)


def same(one, other):
    return all(
        np.array_equal(getattr(one, name), getattr(other, name), equal_nan=True)
        for name in ("scores", "slots", "curves", "time_s", "seeds")
    )


WAIT_S = 600.0  # far beyond what anything here takes; reached only when something hangs


class Now(Executor):
    """Runs a job when it is submitted, and counts."""

    def __init__(self, answer=run_seed):
        self.answer, self.jobs = answer, []

    def submit(self, function, *arguments):
        self.jobs.append(arguments[1:])
        future = Future()
        future.set_result(self.answer(*arguments))
        return future


# ------------------------------------------------------------------------------------- the same numbers


def test_a_run_does_not_depend_on_the_other_runs(small, tmp_path):
    alone = run_campaign(SMALL, (4,), ("oracle",), tmp_path)
    results = small[1]
    assert np.array_equal(alone.scores[0, :, 0], results.scores[2, :, 1], equal_nan=True)
    assert not np.array_equal(results.scores[2, :, 0], results.scores[2, :, 1])


def test_a_dask_cluster_gives_the_same_numbers(small, tmp_path):
    distributed = pytest.importorskip("distributed", reason="install navfilter[dask] to run this test")
    with (
        distributed.LocalCluster(n_workers=1, threads_per_worker=1, processes=False, dashboard_address=None) as local,
        cluster(local.scheduler_address) as executor,
    ):
        assert same(
            run_campaign(SMALL, SEEDS[:2], MODELS, tmp_path, executor), run_campaign(SMALL, SEEDS[:2], MODELS, small[0])
        )


def test_dask_is_asked_for_by_name_when_it_is_missing(monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(ValueError, match=r"navfilter\[dask\]"), cluster("tcp://127.0.0.1:1"):
        pass


# ------------------------------------------------------------------------------------- stopped and continued


def test_a_stopped_campaign_continues_where_it_was(small, tmp_path):
    def stop(done):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_campaign(SMALL, SEEDS, MODELS, tmp_path, progress=stop)
    assert len(list((tmp_path / "runs").rglob("*.npz"))) == len(MODELS)
    left, counted = Now(), []
    assert same(run_campaign(SMALL, SEEDS, MODELS, tmp_path, left, counted.append), small[1])
    assert left.jobs == [(4, MODELS), (5, MODELS)] and counted == [3, 3, 3]


def test_a_finished_campaign_is_only_read(small):
    idle = Now()
    assert same(run_campaign(SMALL, SEEDS, MODELS, small[0], idle), small[1]) and idle.jobs == []


def test_damaged_and_half_written_runs_are_run_again(small, tmp_path):
    run_campaign(SMALL, SEEDS, MODELS, tmp_path)
    store = Store(tmp_path, SMALL.settings)
    whole = store.path(3, "oracle").read_bytes()
    store.path(3, "oracle").write_bytes(whole[: len(whole) // 2])
    # another run under this name: sound in itself, but not of these settings
    Store(tmp_path / "other", {"a": 1}).save(4, "vehicle", {"scores": np.zeros(3)})
    store.path(4, "vehicle").write_bytes(Store(tmp_path / "other", {"a": 1}).path(4, "vehicle").read_bytes())
    store.path(5, "vehicle").unlink()
    store.path(5, "vehicle").with_name(".00000005.npz.1.part").write_bytes(whole)
    again = Now()
    assert same(run_campaign(SMALL, SEEDS, MODELS, tmp_path, again), small[1])
    assert again.jobs == [(3, ("oracle",)), (4, ("vehicle",)), (5, ("vehicle",))]


def test_one_wrong_bit_is_noticed(small, tmp_path):
    store = Store(tmp_path, {"a": 1})
    record = {"scores": np.arange(6.0), "cpu_s": np.array(1.0)}
    store.save(1, "white", record)
    assert np.array_equal(store.load(1, "white")["scores"], record["scores"])
    with np.load(store.path(1, "white")) as file:
        content = {name: file[name] for name in file.files}
    content["scores"][3] = np.nextafter(3.0, 4.0)
    np.savez(store.path(1, "white"), **content)
    assert store.load(1, "white") is None and store.load(2, "white") is None


@pytest.mark.parametrize(
    "change",
    [{"duration_s": 110.0}, {"gyro": "mems"}, {"motion": "transit"}, {"score_from_s": 41.0}, {"smooth": False}],
)
def test_other_settings_are_refused_by_name(small, change):
    from dataclasses import replace

    with pytest.raises(ValueError, match=next(iter(change))) as refused:
        run_campaign(replace(SMALL, **change), SEEDS, MODELS, small[0])
    assert "there" in str(refused.value) and "--out" in str(refused.value)


def test_the_program_is_all_that_a_run_depends_on(monkeypatch):
    read = []
    monkeypatch.setattr(Path, "read_bytes", lambda path: read.append(path) or b"")
    campaigns.program.__wrapped__()
    package = Path(campaigns.__file__).parents[2]
    rooms = {path.relative_to(package).parts[0] for path in read if path.is_relative_to(package)}
    assert rooms >= {"kernels", "filter", "faults", "learning", "playback", "simulation", "evaluation", "models"}
    assert not rooms & {"commands", "report", "check"}


def test_a_changed_program_does_not_continue_an_old_campaign(small, monkeypatch):
    monkeypatch.setattr(campaigns, "program", lambda: "9.9.9 feedbeef")
    with pytest.raises(ValueError, match="feedbeef"):
        run_campaign(SMALL, SEEDS, MODELS, small[0])


@pytest.mark.parametrize(
    ("error", "kind", "says"),
    [(BrokenProcessPool("gone"), ChildProcessError, "worker"), (ValueError("no."), ValueError, "seed 3")],
)
def test_what_goes_wrong_in_a_worker_is_told(tmp_path, error, kind, says):
    class Broken(Executor):
        def submit(self, *_):
            future = Future()
            future.set_exception(error)
            return future

    with pytest.raises(kind, match=says):
        run_campaign(SMALL, (3,), MODELS, tmp_path, Broken())


def first_run(folder, running):
    """Wait until a run is kept."""
    until = time.monotonic() + WAIT_S
    while not list(folder.rglob("*.npz")):
        assert running.poll() is None, running.communicate()
        assert time.monotonic() < until, "no run was ever kept"
        time.sleep(0.02)


def gone(group):
    """Wait until no process of the group is left (the system takes a moment to clear ended ones away)."""
    until = time.monotonic() + WAIT_S
    while time.monotonic() < until:
        try:
            os.killpg(group, 0)
        except ProcessLookupError:
            return True
        time.sleep(0.02)
    return False


@pytest.mark.skipif(os.name == "nt", reason="signals of POSIX")
@pytest.mark.parametrize("how", ["interrupted", "killed"])
def test_a_campaign_that_ends_early_leaves_finished_runs_and_no_processes(tmp_path, how):
    """One worker: when a run is kept, every process has begun its work, however slow the machine."""
    command = [
        sys.executable,
        "-m",
        "navfilter",
        "montecarlo",
        "--scenario",
        "compass-gm1",
        "--runs",
        "10000",
        "--models",
        "vehicle",
    ]
    command += ["--duration", "90", "--imu-rate", "20", "--no-smooth", "--workers", "1", "--out", str(tmp_path)]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    # as in a terminal: what a shell starts in the background ignores the signal, and so would its children
    before = signal.signal(signal.SIGINT, signal.SIG_DFL)
    try:
        running = subprocess.Popen(command, start_new_session=True, **pipes)
    finally:
        signal.signal(signal.SIGINT, before)
    first_run(tmp_path, running)
    if how == "interrupted":
        # as a terminal does: to the whole group, workers included
        os.killpg(running.pid, signal.SIGINT)
    else:
        running.kill()
    _, said = running.communicate(timeout=WAIT_S)
    assert "Traceback" not in said
    if how == "interrupted":
        assert running.returncode == 130 and "the same command continues" in said and not list(tmp_path.rglob("*.part"))
    assert 1 <= len(list(tmp_path.rglob("*.npz"))) < 10000
    assert gone(running.pid)


def test_a_pool_that_is_left_early_leaves_no_thread_behind():
    """The interpreter would wake it on its way out, through a pipe that it may be closing at that moment."""
    before = set(threading.enumerate())
    with pytest.raises(KeyboardInterrupt), process_pool(1) as pool:
        assert pool.submit(abs, -1).result(WAIT_S) == 1
        raise KeyboardInterrupt
    assert not [thread for thread in set(threading.enumerate()) - before if not thread.daemon]


# ------------------------------------------------------------------------------------- what is told


def test_the_table_has_its_columns_and_all_models(small):
    text = table(small[1])
    assert "3 runs (seeds 3 to 5), 100 s each, scored from 40 s" in text and SMALL.name in text
    for words in (
        "heading rms "
        "[deg]", "position rms "
                 "[m]", "end of dive [m]", "[% of way]", "ANEES position", "ANEES heading", "NIS of all sensors",
        "white", "runs with "
                 "adoptions", "divided by gm1-fitted", "divided by oracle", "smoothed",
    ):  # fmt: skip
        assert words in text, words
    assert all(text.count(f"\n{model} ") >= 4 for model in MODELS)
    assert max(map(len, text.splitlines())) <= 180


def test_files_say_the_same_as_the_results(small, tmp_path):
    results = small[1]
    write_tables(results, tmp_path)
    with open(tmp_path / "results.csv", newline="") as file:
        lines = list(csv.DictReader(file))
    content = json.loads((tmp_path / "results.json").read_text())
    assert len(lines) == len(content["results"]) == len(rows(results))
    q = SCORES.index("heading_rms_deg")
    wanted = np.sqrt(np.mean(results.scores[2, 1, :, q] ** 2))
    line = next(
        v
        for v in lines
        if (v["model"], v["track"], v["quantity"], v["reference"]) == ("oracle", "smoothed", "heading_rms_deg", "")
    )
    assert (
        float(line["value"]) == wanted
        and int(line["runs"]) == 3
        and float(line["low"]) <= wanted <= float(line["high"])
    )
    assert content["campaign"]["scenario"] == "compass-gm1-white" and content["seeds"] == list(SEEDS)
    with np.load(tmp_path / "runs.npz") as file:
        assert np.array_equal(file["scores"], results.scores, equal_nan=True) and file["curve_names"].tolist() == list(
            CURVES
        )


def test_scores_are_those_of_the_track(small):
    """Against `Track.summary`, which goes another way."""
    from navfilter.evaluation.baselines import rivals
    from navfilter.playback.replay import replay

    staged = SMALL.staged
    mission = staged.mission(4)
    vehicle = rivals(["gm1-fitted"], staged.vehicle, mission, sensors=("compass",))["gm1-fitted"]
    smoothed = replay(vehicle, mission, smooth=True, output_rate_hz=1.0)
    for t, track in enumerate((smoothed.forward, smoothed)):
        told = track.summary(mission.truth, ((40.0, 100.0),))
        found = dict(zip(SCORES, small[1].scores[1, t, 1], strict=True))
        for here, there in (("heading_rms_deg", "heading_rms_deg"), ("position_rms_m", "position_rms_m"), ("anees_heading", "nees_heading"),
                            ("anees_position", "nees_position")):  # fmt: skip
            assert found[here] == pytest.approx(told[there], rel=1e-12)


def test_figures_are_drawn(small, tmp_path):
    names = write_figures(small[1], tmp_path)
    assert set(names) == {"envelope-forward.png", "envelope-smoothed.png", "nees.png", "end-error.png"}
    assert all((tmp_path / name).read_bytes().startswith(b"\x89PNG") for name in names)


def test_without_the_smoother_there_is_one_track(tmp_path):
    from dataclasses import replace

    results = run_campaign(replace(SMALL, smooth=False), (3,), ("vehicle",), tmp_path)
    assert results.tracks == ("forward",) and np.isnan(results.scores[:, 1]).all() and "smoothed" not in table(results)
    assert "envelope-smoothed.png" not in write_figures(results, tmp_path)


def test_the_truth_is_honest_and_the_other_is_not(tmp_path):
    """Sixteen missions: heading NEES of the oracle within the 99.9 % band at two times, NIS near one, innovations
    white.
    """
    campaign = Campaign("compass-rolling", duration_s=100.0, score_from_s=30.0, imu_rate_hz=20.0, smooth=False)
    results = run_campaign(campaign, range(1, 17), ("vehicle", "oracle"), tmp_path)
    low, high = (chi_square_limit(p, 16) / 16 for p in (0.0005, 0.9995))
    curve = results.curves[1, 0, :, CURVES.index("nees_heading")]
    for at in (35.0, 95.0):
        assert low < curve[:, np.searchsorted(results.time_s, at)].mean() < high
    nis = results.scores[:, 0, :, SCORES.index("nis_sensor")]
    # 560 readings a run: 0.015 is the sd of the mean over runs; outliers below the gate add 0.01
    assert nis[1].mean() == pytest.approx(1.0, abs=0.06) and nis[0].mean() > 2.0
    white = results.scores[:, 0, :, SCORES.index("white")].mean(axis=1)
    # the test calls 1 % of white series coloured
    assert white[1] >= 0.8 and white[0] <= 0.2


# ------------------------------------------------------------------------------------- intervals


def test_mean_interval_is_students():
    x = np.random.default_rng(1).normal(3.0, 2.0, 12)
    low, high = stats.t.interval(0.95, 11, x.mean(), stats.sem(x))
    assert mean_interval(x) == pytest.approx((x.mean(), low, high), rel=1e-12)
    assert mean_interval([*x, np.nan]) == mean_interval(x)
    assert np.isnan(mean_interval([])).all() and mean_interval([2.0])[0] == 2.0 and np.isnan(mean_interval([2.0])[1])


@pytest.mark.parametrize(
    ("held", "n", "low", "high"), [(8, 10, 0.490, 0.943), (0, 50, 0.0, 0.0713), (1, 1, 0.2065, 1.0)]
)
def test_share_interval_is_wilsons(held, n, low, high):
    """Newcombe (1998) gives such values; here by the quadratic that Wilson solves: (p - x)^2 = z^2 x (1 - x) / n."""
    value, found_low, found_high = share_interval([1.0] * held + [0.0] * (n - held))
    z2 = stats.norm.ppf(0.975) ** 2
    roots = np.sort(np.roots([1.0 + z2 / n, -2.0 * value - z2 / n, value**2]).real)
    assert (found_low, found_high) == pytest.approx(np.clip(roots, 0.0, 1.0), abs=1e-9)
    assert (found_low, found_high) == pytest.approx((low, high), abs=6e-4)


def test_bootstrap_intervals_cover_the_truth():
    """Of 300 campaigns with 40 runs, nominally 95 %; percentile intervals cover a little less with few runs."""
    rng = np.random.default_rng(2)
    hit, hit_ratio = 0, 0
    for _ in range(300):
        size = np.sqrt(rng.chisquare(6, 40) / 6.0)  # what both models share: the mission
        a, b = (np.sqrt(rng.chisquare(20, 40) / 20.0) * size for _ in range(2))
        value, low, high = rms_interval(size)
        assert low < value < high
        hit += low <= 1.0 <= high
        _, low, high = ratio_interval(0.8 * a, b)
        hit_ratio += low <= 0.8 <= high
    assert 0.88 <= hit / 300 <= 0.985 and 0.88 <= hit_ratio / 300 <= 0.985


def test_pairs_tell_more_than_two_intervals():
    """Missions differ by far more than models: only in pairs is the difference seen."""
    rng = np.random.default_rng(3)
    mission = rng.lognormal(0.0, 1.0, 30)
    a, b = 0.9 * mission * rng.lognormal(0.0, 0.02, 30), mission
    value, low, high = ratio_interval(a, b)
    assert high < 1.0 and high - low < 0.1 and low < 0.9 < high
    assert rms_interval(a)[2] > rms_interval(b)[1]
    assert value == pytest.approx(np.sqrt(np.mean(a**2) / np.mean(b**2)), rel=1e-12)
    with pytest.raises(ValueError, match="same runs"):
        ratio_interval(a, b[:5])


def test_the_range_of_chi_square_is_that_of_the_mean():
    rng = np.random.default_rng(4)
    means = (rng.normal(size=(20_000, 10, 3)) ** 2).mean(axis=(1, 2))
    low, high = chi_square_range(30)
    # sd of a share of 2.5 % in 20 000: 0.11 %
    assert np.mean(means < low) == pytest.approx(0.025, abs=0.005) and np.mean(means > high) == pytest.approx(
        0.025, abs=0.005
    )


# ------------------------------------------------------------------------------------- the command


def arguments(out, *more):
    return ["montecarlo", "--scenario", "compass-gm1-white", "--runs", "2", "--seed", "3", "--models", "vehicle,oracle",
            "--duration", "100", "--imu-rate", "20", "--score-start", "40", "--workers", "1", "--out", str(out), *more]  # fmt: skip


def test_the_command_writes_everything_and_says_the_table(small, tmp_path, capsys):
    """Its numbers, those of two worker processes, are those of this process."""
    assert main(arguments(tmp_path, "--workers", "2")) == 0
    said = capsys.readouterr().out
    written = {path.name for path in tmp_path.glob("[!.]*")}
    assert written >= {
        "table.txt",
        "results.csv",
        "slots.csv",
        "results.json",
        "runs.npz",
        "nees.png",
        "end-error.png",
        "campaign.json",
        "runs",
    }
    assert (tmp_path / "table.txt").read_text().strip() in said
    with np.load(tmp_path / "runs.npz") as file:
        here = small[1].scores[np.ix_([MODELS.index("vehicle"), MODELS.index("oracle")], [0, 1], [0, 1])]
        assert np.array_equal(file["scores"], here, equal_nan=True)
    assert main(arguments(tmp_path, "--quiet")) == 0
    again = capsys.readouterr()
    assert again.out == "" and again.err == ""


def test_the_list_names_all_scenarios(capsys):
    from navfilter.simulation.scenarios import STUDIES

    assert main(["montecarlo", "--list"]) == 0
    assert [line.split()[0] for line in capsys.readouterr().out.splitlines()] == list(STUDIES)


@pytest.mark.parametrize(
    ("more", "says"),
    [
        (["--scenario", "nowhere"], "no scenario"),
        (["--models", "white,magic"], "magic"),
        (["--models", ","], "no"),
        (["--scenario", "compass-triples", "--models", "oracle"], "noise changes"),
        (["--score-start", "200"], "within the mission"),
        (["--gyro", "mems"], "gyro 'tactical' there, 'mems' here"),
    ],
)
def test_wrong_use_is_one_line(small, capsys, more, says):
    assert main(arguments(small[0], *more)) == 2
    said = capsys.readouterr()
    assert said.err.startswith("navfilter: ") and said.err.count("\n") == 1 and says in said.err


def test_a_scenario_that_changes_goes_without_the_oracle(in_process, tmp_path, capsys):
    assert main(arguments(tmp_path, "--scenario", "compass-triples", "--no-smooth")) == 0
    assert "no oracle" in capsys.readouterr().out
    assert sorted(path.name for path in Path(tmp_path, "runs").iterdir()) == ["vehicle"]
