"""Identification of a recorded series: reading files, conditioning, choice of model, its reading in words, what is
written.
"""

import gzip
import json
import lzma
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np
import pytest
import scipy.io

import navfilter as nf
from navfilter.commands.cli import main
from navfilter.identification.conditioning import MAX_SAMPLES, condition, gap_free, quantisation_step
from navfilter.identification.identify import identify, model_allan_deviation
from navfilter.identification.online import track_online, tracks_text
from navfilter.identification.report import as_dict, error_lines, identification_figures, summary_text
from navfilter.io.inertial import Series, on_a_grid, read_series
from navfilter.io.table import TableOptions
from navfilter.models.error_models import Arma, GaussMarkov, RandomWalk, Sum, White
from navfilter.models.interpretation import read_model
from navfilter.models.mission import Mission, MissionError, Stream

WALK_AND_WHITE = ([-1.0], [-0.95])


def arma(ar, ma, n, seed=1, sd=1.0):
    return nf.simulate_arma(ar, ma, sd, n, seed)


def small(x, **how):
    """Identify with few orders: the choice among many is tested where it is made."""
    return identify(x, 10.0, **({"max_p": 2, "max_q": 2} | how))


# --- reading --------------------------------------------------------------------------------------------------------

TEXT = "Fs,10\nt,a,b\n" + "".join(f"{k / 10},{k},{-k}\n" for k in range(60))


def write(path: Path) -> Path:
    """The numbers 0, -1, -2 .. in a column called b, in the format of the file's name."""
    b = -np.arange(60.0)
    match path.suffix:
        case ".csv":
            path.write_text(TEXT)
        case ".gz":
            path.write_bytes(gzip.compress(TEXT.encode()))
        case ".xz":
            path.write_bytes(lzma.compress(TEXT.encode()))
        case ".npz":
            np.savez(path, a=np.arange(60.0), b=b)
        case ".npy":
            np.save(path, np.stack([np.zeros((3, 60)), np.stack([b, b + 1, b])]))
        case ".mat":
            scipy.io.savemat(path, {"a": np.arange(60.0), "b": b})
    return path


@pytest.mark.parametrize("name", ["x.csv", "x.csv.gz", "x.csv.xz", "x.npz", "x.mat"])
def test_reads_a_column_of_any_table(tmp_path, name):
    lines = 1 if "csv" in name else 0
    series = read_series(write(tmp_path / name), "b", rate_hz=10.0, options=TableOptions(skip_lines=lines))
    np.testing.assert_array_equal(series.value, -np.arange(60.0))
    assert (series.name, series.rate_hz, series.begin_s) == ("b", 10.0, 0.0)


def test_finds_the_header_below_a_preamble_and_the_column_of_an_array(tmp_path):
    series = read_series(write(tmp_path / "x.csv.xz"), "b", rate_hz=10.0)
    np.testing.assert_array_equal(series.value, -np.arange(60.0))
    assert series.notes == ("the header was found on line 2",)
    np.savez(tmp_path / "y.npz", counts=np.arange(120).reshape(60, 2), scale=np.ones(2))
    np.testing.assert_array_equal(
        read_series(tmp_path / "y.npz", "counts[1]", rate_hz=1.0).value, np.arange(1.0, 120.0, 2.0)
    )
    (tmp_path / "broken.csv.gz").write_bytes(b"no gzip")
    with pytest.raises(MissionError, match="cannot be unpacked"):
        read_series(tmp_path / "broken.csv.gz", "b", rate_hz=1.0)


def test_reads_a_plane_of_an_array_by_position(tmp_path):
    options = TableOptions(table="[1]", transpose=True)
    series = read_series(write(tmp_path / "x.npy"), "1", rate_hz=10.0, options=options)
    np.testing.assert_array_equal(series.value, 1.0 - np.arange(60.0))


def test_reads_a_stream_of_a_mission_by_the_beginning_of_its_column(tmp_path):
    time = 5.0 + np.arange(50) / 8.0
    streams = {
        "compass": Stream(time, np.arange(50.0), ("heading_rad",)),
        "imu": Stream(time, np.zeros((50, 2)), ("rate_x_rad_s", "rate_y_rad_s")),
    }
    path = Mission("dive", streams).save(tmp_path / "dive.npz")
    series = read_series(f"{path}:compass")
    assert (series.name, series.rate_hz, series.begin_s) == ("compass.heading_rad", 8.0, 5.0)
    np.testing.assert_array_equal(series.value, np.arange(50.0))
    assert read_series(f"{path}:imu.rate_y").name == "imu.rate_y_rad_s"
    with pytest.raises(MissionError, match=r"rate_x_rad_s, rate_y_rad_s"):
        read_series(f"{path}:imu")
    with pytest.raises(ValueError, match=r"streams: compass, imu"):
        read_series(f"{path}:depth")


@pytest.mark.parametrize(
    "how, words",
    [
        ({"column": "c", "rate_hz": 10.0}, '"t", "a", "b"'),
        ({"column": "7", "rate_hz": 10.0}, "0 to 2"),
        ({"rate_hz": 10.0}, "--column"),
        ({"column": "b"}, "--rate-hz"),
    ],
)
def test_says_what_is_missing(tmp_path, how, words):
    with pytest.raises(MissionError, match=words) as error:
        read_series(write(tmp_path / "x.csv"), **how, options=TableOptions(skip_lines=1))
    assert "\n" not in str(error.value)


def test_times_become_an_even_grid_with_gaps_and_without_repeats():
    rng = np.random.default_rng(1)
    # Runs at 99.3 Hz, jitters by a fifth of a period, loses 3 samples after the tenth, repeats one row.
    t = np.delete(np.arange(200), [10, 11, 12]) / 99.3 + rng.uniform(-1e-3, 1e-3, 197)
    t, x = np.insert(t, 50, t[49]), np.insert(np.arange(197.0), 50, 49.0)
    series = on_a_grid("x", t, x, None)
    assert series.value.size == 200
    assert list(np.flatnonzero(np.isnan(series.value))) == [10, 11, 12]
    assert series.rate_hz == pytest.approx(99.3, rel=0.02)
    assert "1 row with the time" in series.notes[0] and "3 samples missing in 1 gap" in series.notes[1]
    with pytest.raises(MissionError, match="goes back 1 time"):
        on_a_grid("x", np.r_[t, 0.0], np.r_[x, 0.0], None)
    with pytest.raises(MissionError, match=r"not 0\.001 s"):
        on_a_grid("x", t, x, 1000.0)


# --- conditioning ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("step", [1.0, 0.05, 1e-6])
def test_quantisation_step(step):
    x = np.random.default_rng(1).standard_normal(3000)
    assert quantisation_step(np.round(3.0 * x) * step) == pytest.approx(step, rel=1e-3)
    assert quantisation_step(x * step) == 0.0


def test_step_is_seen_through_too_few_printed_digits():
    x = np.round(np.random.default_rng(1).standard_normal(3000) * 2.0) * 0.085
    assert quantisation_step(np.round(x, 2)) == pytest.approx(0.085, rel=0.1)


def test_held_values_are_thinned_and_coarse_ones_kept():
    x = arma([-0.9], [], 1000)
    held = condition(Series("x", np.repeat(x, 4), 40.0))
    np.testing.assert_array_equal(held.value, x)
    assert held.rate_hz == 10.0 and any("repeated 4 times" in note for note in held.notes)
    coarse = condition(Series("x", np.round(x / 3.0), 10.0))
    assert coarse.value.size == 1000 and any("coarse" in note for note in coarse.notes)


def test_part_of_a_record():
    x = np.arange(1000.0) % 7
    data = condition(Series("x", x, 10.0, begin_s=100.0), from_s=110.0, to_s=119.95, decimate=2)
    np.testing.assert_array_equal(data.value, x[100:200:2])
    assert (data.begin_s, data.rate_hz) == (110.0, 5.0)
    np.testing.assert_array_equal(condition(Series("x", x, 10.0), seasonal_lag=7).value[:5], 0.0)
    with pytest.raises(ValueError, match=r"lasts from 100 to 199\.9"):
        condition(Series("x", x, 10.0, begin_s=100.0), from_s=300.0)


def test_impulses_become_missing():
    x = arma([-0.8], [], 2000)
    bad = np.array([100, 900, 1500])
    spoilt = x.copy()
    spoilt[bad] += 50.0
    found = condition(Series("x", spoilt, 1.0), reject=8.0)
    assert list(np.flatnonzero(np.isnan(found.value))) == list(bad)


def test_a_long_record_is_fitted_in_its_middle_and_says_so():
    x = np.random.default_rng(1).standard_normal(MAX_SAMPLES + 1000)
    data = condition(Series("x", x, 100.0))
    np.testing.assert_array_equal(data.value, x[500:-500])
    assert data.whole.size == x.size and any("--max-samples" in note for note in data.notes)


@pytest.mark.parametrize(
    "x, words",
    [
        (np.full(200, 3.25), "is constant"),
        (np.full(200, np.nan), "0 usable samples"),
        (np.array([]), "0 usable samples|no samples"),
        (np.arange(20.0), "20 usable samples"),
        (np.zeros((200, 2)), "one series"),
        (np.array(["a"] * 200), "not real numbers"),
    ],
)
def test_unusable_series_are_refused_in_one_line(x, words):
    with pytest.raises(ValueError, match=words) as error:
        identify(x, 10.0)
    assert "\n" not in str(error.value)


# --- reading a model in words ---------------------------------------------------------------------------------------


def sum_of(*models):
    return nf.timeseries.add_arma([nf.ArmaModel(np.array(ar, dtype=float), np.array([]), sd) for ar, sd in models])


@pytest.mark.parametrize(
    "model, text, error",
    [
        (sum_of(([], 2.0)), "white noise; minimal order (0,0)", White),
        (sum_of(([-0.99], 1.0)), "first-order Gauss-Markov, tau = 0.99 s; minimal order (1,0)", GaussMarkov),
        (
            sum_of(([-0.99], 0.3), ([], 1.0)),
            "first-order Gauss-Markov, tau = 0.99 s + white noise; minimal order (1,1)",
            Sum,
        ),
        (sum_of(([-1.0], 0.1), ([], 1.0)), "random-walk bias + white noise; minimal order (1,1)", Sum),
        (
            sum_of(([-1.0], 0.01), ([], 1.0), ([1.95, 0.96], 0.05)),
            "random-walk bias + a line near Nyquist + white noise; minimal order (3,3)",
            Sum,
        ),
        (
            sum_of(([-0.998], 0.1), ([], 1.0), ([-2 * 0.98 * np.cos(0.3), 0.98**2], 0.05)),
            "first-order Gauss-Markov, tau = 5.0 s + a line at 4.77 Hz + white noise; minimal order (3,3)",
            Arma,
        ),
        (
            nf.ArmaModel(np.array([]), np.array([0.17]), 1.0),
            "moving average from the device's own filtering; minimal order (0,1)",
            Arma,
        ),
        (
            nf.ArmaModel(np.array([0.14]), np.array([]), 1.0),
            "short correlation from the device's own filtering; minimal order (1,0)",
            Arma,
        ),
        (
            nf.ArmaModel(np.array([-1.839, 0.848]), np.array([]), 1.0),
            "second-order Gauss-Markov, tau = 0.26 s; minimal order (2,0)",
            Arma,
        ),
        (
            nf.timeseries.gauss_markov_arma(2, 1.0, 5.0, 100.0),
            "second-order Gauss-Markov, tau = 0.43 s; minimal order (2,1)",
            Arma,
        ),
        (nf.ArmaModel(np.array([-1.5, 0.5]), np.array([]), 1.0), "random walk with correlated steps", Arma),
    ],
    ids=lambda value: value[:40] if isinstance(value, str) else "",
)
def test_reading(model, text, error):
    n = 20_000
    model = nf.ArmaModel(model.ar, model.ma, model.sd, np.zeros((model.p + model.q,) * 2))
    reading = read_model(model, 100.0, n)
    assert reading.text.startswith(text)
    assert isinstance(reading.error, error)


def test_parts_of_a_sum_are_recovered():
    model = sum_of(([-0.99], 0.3), ([], 1.0))
    slow, white = read_model(nf.ArmaModel(model.ar, model.ma, model.sd, np.eye(2) * 1e-10), 100.0, 20_000).components
    assert white.sd == pytest.approx(1.0, rel=1e-6)
    assert slow.sd == pytest.approx(0.3 / np.sqrt(1 - 0.99**2), rel=1e-6)
    assert slow.tau_s == pytest.approx(-0.01 / np.log(0.99), rel=1e-6)


def test_a_bias_far_below_the_noise_is_named():
    """A hundredth of the sample's variance, but ten times its density at low frequency: it decides the navigation
    error.
    """
    model = sum_of(([-0.999], 0.0045), ([], 1.0))
    reading = read_model(nf.ArmaModel(model.ar, model.ma, model.sd, np.eye(2) * 1e-10), 100.0, 50_000)
    assert reading.text.startswith("first-order Gauss-Markov, tau = 10 s") and "+ white noise" in reading.text


def test_suggested_walk_keeps_its_strength_at_another_rate():
    """A density does not depend on the rate: the walk of every second sample steps sqrt(2) further."""
    model = sum_of(([-1.0], 0.1), ([], 1.0))
    slow = nf.timeseries.resample_arma(model, 2)
    density = []
    for m, rate in ((model, 100.0), (slow, 50.0)):
        error = read_model(nf.ArmaModel(m.ar, m.ma, m.sd, np.zeros((2, 2))), rate, 10_000).error
        assert isinstance(error, Sum) and isinstance(error.parts[0], RandomWalk)
        density.append(error.parts[0].density)
    assert density[0] == pytest.approx(1.0) and density[1] == pytest.approx(1.0, rel=1e-4)


# --- identification -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "ar, ma, order",
    [
        ([], [], (0, 0)),
        ([-0.9], [], (1, 0)),
        ([], [-0.5], (0, 1)),
        ([-0.95], [-0.6], (1, 1)),
        ([-1.6, 0.8], [], (2, 0)),
    ],
)
def test_simulated_orders_are_found(ar, ma, order):
    found = small(arma(ar, ma, 3000, seed=4))
    assert (found.fit.p, found.fit.q) == order and found.tests.is_white
    truth = np.r_[ar, ma]
    # Four standard deviations: five fixed seeds, so that a wrong estimate is seen and chance is not.
    sds = np.sqrt(np.diag(found.fit.covariance))
    assert np.all(np.abs(np.r_[found.fit.ar, found.fit.ma] - truth) < 4.0 * sds)


def test_walk_and_white_noise_with_any_offset_and_unit():
    x = arma(*WALK_AND_WHITE, 6000, seed=2)
    for series in (x, 1e6 + x, 1e-12 * x):
        assert small(series).reading.text == "random-walk bias + white noise; minimal order (1,1)"
    differenced = small(x, difference=1)
    assert (differenced.fit.p, differenced.fit.d, differenced.fit.q) == (0, 1, 1)
    assert differenced.reading.text == "random-walk bias + white noise; minimal order (1,1)"
    assert differenced.fit.ma[0] == pytest.approx(-0.95, abs=0.02)


def test_integer_counts_are_as_good_as_their_values():
    counts = np.round(arma([-0.9], [], 3000) * 20.0).astype(np.int16)
    found = small(counts)
    assert (found.fit.p, found.fit.q) == (1, 0) and found.data.step == 1.0
    assert not any("too coarsely" in remark for remark in found.remarks)
    coarse = small(np.round(arma([], [], 3000) * 0.5))
    assert any("too coarsely" in remark for remark in coarse.remarks)


def test_gaps_infinities_and_few_samples_are_handled_and_told():
    x = arma([-0.9], [], 1500, seed=3)
    x[[100, 500, 501, 1200]] = np.nan
    x[700] = np.inf
    found = small(x)
    assert (found.fit.p, found.fit.q) == (1, 0) and found.fit.n == 1495
    assert any("infinite" in remark for remark in found.remarks) and any(
        "missing" in remark for remark in found.remarks
    )
    short = identify(arma([-0.9], [], 130, seed=3), 10.0)
    assert any("130 samples carry no more" in remark for remark in short.remarks)
    assert short.table is not None and short.table.bic.shape == (3, 3)
    x[np.random.default_rng(1).integers(0, 1500, 400)] = np.nan
    assert any("% of the samples are missing" in remark for remark in small(x, max_p=1, max_q=1).remarks)


def test_given_order_is_kept_unless_a_pair_cancels():
    x = arma([-0.9], [], 3000, seed=5)
    found = small(x, order=(3, 1))
    assert (found.fit.p, found.fit.q) == (3, 1) and found.table is None


def test_slow_drift_outside_the_fitted_part_is_told():
    rng = np.random.default_rng(3)
    x = rng.standard_normal(40_000) + np.cumsum(0.002 * rng.standard_normal(40_000))
    found = small(x, max_samples=1000, max_p=1, max_q=1)
    assert any("slow drift" in remark for remark in found.remarks)
    assert not any("slow drift" in remark for remark in small(rng.standard_normal(40_000), max_samples=1000).remarks)


def test_model_allan_deviation():
    counts = np.array([1, 3, 10, 100])
    walk = nf.ArmaModel(np.array([-1.0]), np.array([]), 2.0)
    # Closed form of a sampled random walk: q^2 (2 m^2 + 1) / (6 m).
    np.testing.assert_allclose(
        model_allan_deviation(walk, counts), 2.0 * np.sqrt((2 * counts**2 + 1) / (6 * counts)), rtol=1e-9
    )
    model = nf.ArmaModel(np.array([-1.6, 0.8]), np.array([0.4]), 1.0)
    _, sample = nf.timeseries.allan_deviation(nf.simulate_arma(model.ar, model.ma, 1.0, 400_000, 1), 1.0, counts)
    # 4000 independent averages at the longest: a relative standard deviation of 1.1 %.
    np.testing.assert_allclose(model_allan_deviation(model, counts), sample, rtol=0.05)


def test_online_tracks_follow_a_change():
    x = np.r_[arma([-0.8], [], 6000), arma([-0.5], [], 6000)]
    tracks = track_online(Series("x", x, 10.0), 2000, order=(1, 0))
    before, after = tracks.time_s < 600.0, tracks.time_s > 900.0
    assert np.all(np.abs(tracks.ar[before & (tracks.time_s > 200.0), 0] + 0.8) < 0.1)
    assert np.all(np.abs(tracks.ar[after, 0] + 0.5) < 0.1)
    assert "short correlation" in tracks_text(tracks)
    bank = track_online(Series("x", x, 10.0), 2000)
    assert tuple(bank.order[-1]) == (1, 0) and bank.is_bank
    with pytest.raises(ValueError, match="no shorter than the series"):
        track_online(Series("x", x, 10.0), 20_000)


# --- what is written ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "error",
    [
        White(sd=0.125),
        RandomWalk(density=1e-3) + White(sd=0.1),
        GaussMarkov(sd=0.5, tau_s=30.0) + White(sd=0.1),
        RandomWalk(density=1e-3) + Arma(ar=(-1.6, 0.8), ma=(0.4,), sd=0.1),
        Arma(ar=(), ma=(0.17,), sd=2.0),
    ],
    ids=str,
)
def test_suggested_line_is_what_a_vehicle_reads(tmp_path, error):
    toml, python = error_lines(error)
    text = f'[drive]\ntype = "imu"\nrate_hz = 100\n[sensors.depth]\ntype = "depth"\nrate_hz = 1\n{toml}\n'
    (tmp_path / "vehicle.toml").write_text(text)
    assert nf.read_vehicle(tmp_path).sensors["depth"].error == error
    assert eval(python.removeprefix("error="), {"nf": nf}) == error


def test_suggested_line_is_in_radians():
    assert "sd = 0.0174533" in error_lines(White(sd=1.0), "deg")[0]
    assert "sd = 1.0" in error_lines(White(sd=1.0), "counts")[0]


@pytest.mark.parametrize("unit", ["dps", "°/s", "deg/s"])
def test_other_names_of_a_unit_are_turned_to_si(unit):
    assert "sd = 0.0174533" in error_lines(White(sd=1.0), unit)[0]


@pytest.mark.parametrize("how", [[], ["--online"]])
def test_an_unknown_unit_is_refused_before_anything_is_written(tmp_path, capsys, how):
    with pytest.raises(SystemExit) as stopped:
        main(["identify", str(tmp_path / "a.csv"), "--unit", "degs/s", "--out", str(tmp_path / "out"), *how])
    assert stopped.value.code == 2 and not (tmp_path / "out").exists()
    said = capsys.readouterr().err
    assert 'unknown unit "degs/s" (known: 1, s, ms' in said and "deg/s" in said and "dps" in said
    with pytest.raises(ValueError, match='unknown unit "degs/s"'):
        identify(np.zeros(100), 10.0, unit="degs/s")


def test_a_mission_is_in_si_already(tmp_path, capsys):
    turning = Stream(np.arange(400) / 8.0, np.random.default_rng(1).normal(size=400), ("heading_rad",))
    Mission("turning", {"compass": turning}).save(tmp_path / "m.npz")
    how = ["--order", "1,0", "--out", str(tmp_path / "out"), "--quiet"]
    assert main(["identify", f"{tmp_path / 'm.npz'}:compass", "--unit", "deg", *how]) == 2
    assert "in SI: leave --unit deg out" in capsys.readouterr().err
    assert main(["identify", f"{tmp_path / 'm.npz'}:compass", "--unit", "rad", *how]) == 0


@pytest.fixture(scope="module")
def still(tmp_path_factory):
    """A text file with a walk in white noise, and the folder that identify wrote about it."""
    folder = tmp_path_factory.mktemp("still")
    x = arma(*WALK_AND_WHITE, 4000, seed=2)
    (folder / "still.csv").write_text("time,heading\n" + "".join(f"{k / 8:.3f},{v:.9g}\n" for k, v in enumerate(x)))
    out = folder / "out"
    how = ["--column", "heading", "--rate-hz", "8", "--unit", "deg", "--max-p", "2", "--max-q", "2"]
    assert main(["identify", str(folder / "still.csv"), *how, "--out", str(out), "--quiet"]) == 0
    return folder


_FIGURES = ["series", "psd", "correlation", "orders", "residuals", "residual_correlation", "poles", "allan"]


def test_command_writes_page_numbers_and_figures(still):
    names = {path.name for path in (still / "out").glob("[!.]*")}
    figures = {f"{name}.svg" for name in _FIGURES}
    assert names == figures | {"identify.html", "identify.json"}
    for name in figures:
        ElementTree.parse(still / "out" / name)
    page = (still / "out" / "identify.html").read_text()
    assert page.count("data:image/svg+xml,") == len(figures)
    assert 'src="http' not in page and "<a" not in page and "<script" not in page


def test_numbers_say_everything(still):
    text = (still / "out" / "identify.json").read_text()
    assert "NaN" not in text and "Infinity" not in text
    result = json.loads(text)
    assert result["n"] == 4000 and result["period_s"] == 0.125
    assert result["best"] == {"p": 1, "d": 0, "q": 1}
    assert set(result["fit"]) >= {"ar", "ma", "sd", "covariance", "poles", "zeros"}
    assert np.shape(result["fit"]["covariance"]) == (2, 2) and np.shape(result["fit"]["poles"]) == (1, 2)
    assert np.shape(result["criteria"]["bic"]) == np.shape(result["criteria"]["wt"]) == (3, 3)
    assert (
        result["whiteness"]["is_white"] and result["reading"] == "random-walk bias + white noise; minimal order (1,1)"
    )
    assert result["error"]["toml"].startswith('error = [{model = "random-walk"')
    # 0.05 deg per sample at 8 Hz in rad/sqrt(s), known within the 12 % of two standard deviations of the zero.
    density = float(result["error"]["toml"].split("density = ")[1].split("}")[0])
    assert density == pytest.approx(np.radians(0.05 * np.sqrt(8.0)), rel=0.25)


def test_command_prints_the_reading(still, tmp_path, capsys):
    how = ["--column", "1", "--time-column", "0", "--order", "1,1", "--out", str(tmp_path)]
    assert main(["identify", str(still / "still.csv"), *how]) == 0
    said = capsys.readouterr().out
    assert "random-walk bias + white noise; minimal order (1,1)" in said and "WT" in said and "nf.RandomWalk(" in said
    assert not (tmp_path / "orders.svg").exists()


def test_command_tracks_online(still, tmp_path, capsys):
    how = ["--column", "heading", "--rate-hz", "8", "--online", "--window", "1000", "--out", str(tmp_path)]
    assert main(["identify", str(still / "still.csv"), *how]) == 0
    assert {path.name for path in tmp_path.glob("[!.]*")} == {
        "identify.html",
        "identify.json",
        "tracks.csv",
        "tracks.svg",
    }
    assert "last model: random-walk bias + white noise; minimal order (1,1)" in capsys.readouterr().out
    rows = np.genfromtxt(tmp_path / "tracks.csv", delimiter=",", names=True)
    assert rows["time_s"][-1] == pytest.approx(500.0) and np.all(rows["sd"] > 0.0)


@pytest.mark.parametrize(
    "how, words",
    [
        (["--column", "depth", "--rate-hz", "8"], '"time", "heading"'),
        (["--column", "heading"], "--rate-hz"),
        (["--column", "heading", "--rate-hz", "8", "--from-s", "900"], "lasts from 0 to 499.875"),
        (["--column", "heading", "--rate-hz", "8", "--difference", "3"], "0, 1 or 2"),
        (["--column", "heading", "--rate-hz", "8", "--online", "--window", "9000"], "shorter window"),
    ],
)
def test_command_fails_in_one_line(still, tmp_path, capsys, how, words):
    assert main(["identify", str(still / "still.csv"), *how, "--out", str(tmp_path), "--quiet"]) == 2
    said = capsys.readouterr()
    assert said.out == "" and said.err.count("\n") == 1 and words in said.err


@pytest.mark.parametrize(
    "x", [arma([], [], 200), np.round(arma([], [], 400)), arma([-1.6, 0.9], [], 400), 1e9 + arma([], [], 300)]
)
def test_every_series_can_be_drawn(x):
    found = small(x)
    assert len(list(identification_figures(found))) >= 5
    assert "nan" not in summary_text(found) and json.dumps(as_dict(found), allow_nan=False)


def test_longest_stretch():
    np.testing.assert_array_equal(gap_free(np.array([1.0, np.nan, 2.0, 3.0, np.nan, np.nan, 4.0])), [2.0, 3.0])


# --- recordings -----------------------------------------------------------------------------------------------------


def test_a_raw_gyro_is_white(data_file):
    file = data_file("imu-mpu6050-raw-static/mpu6050_static_450s.csv.xz")
    found = identify(read_series(file, "gx", rate_hz=100.0, options=TableOptions(skip_lines=4)), max_p=3, max_q=3)
    assert found.reading.text == "white noise; minimal order (0,0)" and found.data.step == 1.0


def test_a_barometer_is_a_walk_in_white_noise(data_file):
    file = data_file("baro-static/ms5611_static_altitude_80hz.csv.xz")
    found = identify(read_series(file, "h", rate_hz=80.0, options=TableOptions(skip_lines=2)), max_p=2, max_q=2)
    assert found.reading.text == "random-walk bias + white noise; minimal order (1,1)" and found.tests.is_white
    assert found.fit.ar[0] == pytest.approx(-0.998, abs=0.002) and found.fit.ma[0] == pytest.approx(-0.985, abs=0.005)
