"""The noise sheet of an inertial unit: true parameters are found, the uncertainties are honest, motion is called so."""

import json
import re
from xml.etree import ElementTree

import inertial_noise
import numpy as np
import pytest

import navfilter as nf
from navfilter.commands.cli import main
from navfilter.identification.noise_sheet import (
    NotAtRest,
    allan_curve,
    bands_of,
    drive_terms,
    fit_terms,
    noise_sheet,
    quantisation,
    shape,
    sheet_terms,
    spectral_lines,
    upper_limit,
    usable,
)
from navfilter.identification.noise_sheet_text import plus_minus, sheet_text
from navfilter.identification.static_detection import moving_together, stillness
from navfilter.io.inertial import ImuColumns, ImuRecord, on_a_grid, read_imu
from navfilter.io.table import TableOptions
from navfilter.models.mission import Mission, MissionError, Stream
from navfilter.timeseries.diagnostics import allan_edf

DEG, HOUR = np.pi / 180.0, 3600.0
RATE = 50.0
#: 0.3 deg/sqrt(h), 6 deg/h, 60 deg/h/sqrt(h): a good micromechanical gyro.
WHITE, FLICKER, WALK = 0.3 * DEG / 60.0, 6.0 * DEG / HOUR, 60.0 * DEG / HOUR / 60.0


def noise(n, seed, white=WHITE, rate=RATE, **terms):
    return inertial_noise.noise(n, seed, rate, white, **terms)


def unit_at_rest(seconds=600, seed=1, rate=RATE):
    """Six axes at rest: the gyros in rad/s, the accelerometers in m/s^2 with gravity."""
    n = int(seconds * rate)
    gyro = [noise(n, [seed, k], walk=WALK, rate=rate) + 1e-3 for k in range(3)]
    accel = [noise(n, [seed, k + 3], 1e-3, walk=2e-5, rate=rate) + (-9.81 if k == 2 else 0.02) for k in range(3)]
    return np.column_stack([*gyro, *accel])


NAMES = tuple(f"{group}_{axis}" for group in ("gyro", "accel") for axis in "xyz")


def record(samples, rate=RATE):
    return ImuRecord("still", rate, 0.0, NAMES[: samples.shape[1]], samples, ())


# --- terms and uncertainties ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "sizes, kinds",
    [
        ({"white": WHITE, "walk": WALK}, ("walk",)),
        ({"white": WHITE, "b": FLICKER}, ("flicker",)),
        ({"white": WHITE, "b": FLICKER, "walk": 4 * WALK}, ("flicker", "walk")),
    ],
    ids=["walk", "flicker", "both"],
)
def test_stated_uncertainties_are_honest(sizes, kinds):
    """Errors in units of their stated sd over 40 records: mean 0, sd 1, each known to 0.16 and 0.11."""
    true = {"white": sizes["white"], "flicker": sizes.get("b"), "walk": sizes.get("walk")}
    scores = []
    for seed in range(40):
        fit = fit_terms(bands_of([noise(120_000, seed, **sizes)], RATE), kinds)
        scores.append([np.log(term.size / true[term.kind]) / (term.sd / term.size) for term in fit.terms])
    scores = np.array(scores)
    known = np.abs(scores) < 20.0  # a term at its zero has no logarithm to speak of
    assert known.mean() > 0.93
    assert np.all(np.abs(np.nanmean(np.where(known, scores, np.nan), axis=0)) < 0.6)
    spread = np.nanstd(np.where(known, scores, np.nan), axis=0)
    assert np.all((spread > 0.65) & (spread < 1.45)), spread


def test_quantisation_of_the_angle_is_found_with_its_uncertainty():
    angle, scores = 1e-5, []
    for seed in range(60):
        fit = sheet_terms(bands_of([noise(6000, seed, angle=angle)], RATE))
        size, sd = quantisation(fit, 1.0 / RATE)
        scores.append((size - angle) / sd)
    # 60 records: the sd of their spread is 0.09
    assert abs(np.mean(scores)) < 0.5 and 0.7 < np.std(scores) < 1.35


def test_only_the_terms_that_are_there_are_shown():
    shown = {"white": 0, "walk": 0}
    for seed in range(20):
        white = usable(bands_of([noise(60_000, seed)], RATE))
        walk = usable(bands_of([noise(60_000, seed, walk=4 * WALK)], RATE))
        shown["white"] += len(sheet_terms(white).terms) > 1
        fit = sheet_terms(walk)
        shown["walk"] += fit.term("walk") is not None
        assert [term.kind for term in drive_terms(white).terms] == ["white"]
    # a false term comes about once in 70 records of two possible terms
    assert shown["white"] <= 2 and shown["walk"] >= 18


def test_upper_limits_hold():
    """The true walk, too small to show, lies below its limit in about 95 % of the records."""
    walk, below = 0.15 * WALK, []
    for seed in range(30):
        bands = bands_of([noise(60_000, seed, walk=walk)], RATE)
        fit = fit_terms(bands)
        below.append(upper_limit(bands, fit, "walk") >= walk)
    assert np.mean(below) > 0.85


def test_a_gauss_markov_bias_becomes_a_state():
    rng = np.random.default_rng(3)
    tau, sd, n = 300.0, 40.0 * DEG / HOUR, 900_000
    phi = np.exp(-1.0 / RATE / tau)
    drive = sd * np.sqrt(1 - phi**2) * rng.standard_normal(n)
    from scipy.signal import lfilter

    bias = lfilter([1.0], [1.0, -phi], drive)
    fit = drive_terms(usable(bands_of([noise(n, 4) + bias], RATE)))
    found = fit.term("gauss-markov")
    # five hours hold 30 independent pieces of the bias: its sd is known to 15 %, tau to 30 %
    assert found.size == pytest.approx(sd, rel=0.45) and found.tau_s == pytest.approx(tau, rel=0.8)


def test_several_stretches_tell_more_than_one():
    parts = [noise(20_000, seed, walk=WALK) for seed in range(8)]
    one, all_of_them = (fit_terms(bands_of(some, RATE), ("walk",)) for some in (parts[:1], parts))
    ratio = all_of_them.term("walk").sd / all_of_them.term("walk").size / (one.term("walk").sd / one.term("walk").size)
    assert ratio < 0.6 and all_of_them.term("walk").size == pytest.approx(WALK, rel=0.4)


def test_a_filter_of_the_unit_does_not_move_the_plateau():
    from scipy.signal import butter, lfilter

    smooth = lfilter(*butter(2, 0.3), noise(200_000, 5))
    kept = usable(bands_of([smooth], RATE))
    fit = sheet_terms(kept)
    assert kept.high.max() < 0.5 * RATE and fit.terms[0].size == pytest.approx(WHITE, rel=0.03)


def test_densities_are_those_of_the_error_models():
    """The variance of a sampled Gauss-Markov process is the integral of its density over all frequencies."""
    period = 0.02
    f = np.linspace(-25.0, 25.0, 2_000_001)
    assert np.trapezoid(shape("gauss-markov", f, period, 3.0), f) == pytest.approx(1.0, rel=1e-6)
    assert np.trapezoid(shape("white", f, period), f) == pytest.approx(1.0 / period)


# --- Allan deviation ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["white", "walk"])
def test_degrees_of_freedom_are_those_of_simulated_records(kind):
    rng, n, counts = np.random.default_rng(1), 2048, np.array([1, 7, 40, 200, 682])
    draw = {"white": rng.standard_normal, "walk": lambda n: np.cumsum(rng.standard_normal(n))}[kind]
    variance = np.array([nf.timeseries.allan_deviation(draw(n), 1.0, counts)[1] ** 2 for _ in range(1500)])
    # 1500 draws of a chi-square know their own scatter to 4 % and more where it is skew
    simulated = 2.0 * variance.mean(axis=0) ** 2 / variance.var(axis=0)
    density = None if kind == "white" else lambda f: 1.0 / np.sin(np.pi * f) ** 2
    np.testing.assert_allclose(allan_edf(counts, n, density), simulated, rtol=0.15)


def test_degrees_of_freedom_of_white_noise_are_those_of_the_usual_formula():
    n, m = 4096, np.array([1, 4, 30, 300])
    phases = n + 1.0  # Howe, Allan and Barnes (1981), white noise of frequency
    usual = (1.5 * (phases - 1.0) / m - 2.0 * (phases - 2.0) / phases) * 4.0 * m**2 / (4.0 * m**2 + 5.0)
    np.testing.assert_allclose(allan_edf(m, n), usual, rtol=0.03)
    with pytest.raises(ValueError, match="averages must span 1 to 2048"):
        allan_edf([3000], n)


def test_error_bars_hold_the_truth_two_times_in_three():
    inside = []
    for seed in range(40):
        x = noise(20_000, seed)
        curve = allan_curve([x], RATE, fit_terms(bands_of([x], RATE)))
        true = WHITE / np.sqrt(curve.tau_s)
        inside.append(((curve.low < true) & (true < curve.high))[::6])
    # 40 records with about 5 points of their own: a share of 0.68 scatters by 0.033
    assert 0.58 < np.mean(inside) < 0.78


def test_the_curve_of_the_terms_goes_through_the_points():
    x = noise(200_000, 3, b=4 * FLICKER, walk=8 * WALK, angle=2e-5)
    curve = allan_curve([x], RATE, fit_terms(bands_of([x], RATE), ("flicker", "walk")))
    # up to 20 s the points are known to 2 % and better
    near = curve.tau_s < 20.0
    np.testing.assert_allclose(curve.model[near], curve.deviation[near], rtol=0.08)


# --- lines ----------------------------------------------------------------------------------------------------------


def test_lines_are_found_and_left_out():
    t = np.arange(120_000) / RATE
    amplitude = 30.0 * DEG / HOUR
    scores = []
    for seed in range(15):
        x = noise(t.size, seed) + amplitude * np.sin(2 * np.pi * 7.3 * t + seed)
        (found,) = spectral_lines([x], RATE)
        assert found.frequency_hz == pytest.approx(7.3, abs=0.01)
        scores.append((found.amplitude - amplitude) / found.sd)
    assert abs(np.mean(scores)) < 1.0 and 0.4 < np.std(scores) < 1.6
    assert sum(len(spectral_lines([noise(t.size, seed)], RATE)) for seed in range(15)) == 0
    (with_line,) = noise_sheet(record((x + 0.0)[:, None])).axes
    assert with_line.sheet.terms[0].size == pytest.approx(WHITE, rel=0.02) and len(with_line.sheet.terms) == 1


# --- rest -----------------------------------------------------------------------------------------------------------


def test_a_record_at_rest_is_at_rest_throughout():
    found = stillness(unit_at_rest(), RATE)
    assert found.stretches == ((0, 30_000),) and found.share == 1.0


def test_what_is_handled_is_left_out():
    samples = unit_at_rest(900)
    samples[15_000:17_500, :3] += 0.2 * np.random.default_rng(1).standard_normal((2500, 3))
    samples[17_500:, 3] += 0.5  # it lies differently afterwards
    sheet = noise_sheet(record(samples))
    assert len(sheet.stretches_s) == 2 and 0.9 < sheet.share < 0.95
    assert "only that is used" in sheet.verdict and not sheet.moving
    np.testing.assert_allclose(sheet.stretches_s, [(0, 299), (351, 900)], atol=3)
    assert sheet.axes[0].sheet.terms[0].size == pytest.approx(WHITE, rel=0.05)


def test_a_short_knock_is_bridged():
    samples = unit_at_rest(600)
    samples[10_000:10_100] += 0.3 * np.random.default_rng(1).standard_normal((100, 6))
    sheet = noise_sheet(record(samples))
    assert len(sheet.stretches_s) == 1 and 0.98 < sheet.share < 1.0
    assert sheet.axes[0].sheet.terms[0].size == pytest.approx(WHITE, rel=0.05)


def test_a_turn_that_is_as_quiet_as_rest_is_seen_by_its_level():
    samples = unit_at_rest(600)
    samples[10_000:12_000, 2] += 0.02
    assert len(stillness(samples, RATE).stretches) == 3
    found = stillness(samples, RATE, np.array([0.01] * 3 + [np.inf] * 3))
    np.testing.assert_allclose(np.ravel(found.stretches), [0, 10_000, 12_000, 30_000], atol=150)


def test_a_swell_moves_gyros_and_accelerometers_together():
    samples, t = unit_at_rest(900), np.arange(45_000) / RATE
    sway = np.convolve(
        np.random.default_rng(1).standard_normal(t.size), np.exp(-((np.arange(-300, 300) / 60) ** 2)), "same"
    )
    sway *= 2e-4 / sway.std() * np.cos(2 * np.pi * 0.2 * t)
    samples[:, 0] += sway
    samples[:, 4] += 9.81 * np.cumsum(sway) / RATE * np.sign(1.0)
    sheet = noise_sheet(record(samples))
    assert sheet.verdict.startswith("NOT AT REST: gyro x and accel y")
    quiet = unit_at_rest(900)
    assert moving_together(list(quiet[:, :3].T), list(quiet[:, 3:].T), RATE) == ()


def test_a_record_that_never_rests_is_refused():
    samples = unit_at_rest(200)
    bursts = np.repeat(np.random.default_rng(1).uniform(0.01, 1.0, 400), 25)[:, None]
    with pytest.raises(NotAtRest, match="still: not at rest: no stretch of half a minute in 200 s"):
        noise_sheet(record(samples + bursts * np.random.default_rng(2).standard_normal(samples.shape)))
    with pytest.raises(ValueError, match="gyro_y is constant"):
        noise_sheet(record(np.column_stack([samples[:, 0], np.zeros(len(samples))])))


# --- what is written ------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def still(tmp_path_factory):
    """A table of a unit at rest, as a logger with its own units writes it."""
    folder = tmp_path_factory.mktemp("still")
    samples = unit_at_rest(600)
    samples[:, :3] = np.round(np.degrees(samples[:, :3]), 5)
    samples[:, 3:] /= 9.80665
    table = np.column_stack([1e3 * np.arange(len(samples)) / RATE, samples])
    header = "t_ms,gyro_x,gyro_y,gyro_z,acc_x,acc_y,acc_z"
    np.savetxt(folder / "still.csv", table, delimiter=",", header=header, comments="", fmt="%.8g")
    return folder


HOW = ["--imu", "--time-column", "t_ms", "--time-unit", "ms", "--gyro-unit", "deg/s"]


def test_command_writes_a_sheet_and_a_drive_that_a_vehicle_takes(still, tmp_path, capsys):
    assert main(["identify", str(still / "still.csv"), *HOW, "--out", str(tmp_path / "sheet")]) == 0
    said = capsys.readouterr().out
    assert "at rest throughout (600 s)" in said and "angle random walk [deg/sqrt(h)]" in said
    assert "accel is taken to be in g, because gravity reads 1" in said
    names = {path.name for path in (tmp_path / "sheet").glob("[!.]*")}
    figures = {"allan_gyro.svg", "allan_accel.svg", "spectrum_gyro.svg", "spectrum_accel.svg", "record.svg"}
    assert names == figures | {"identify.html", "identify.json", "drive.toml"}
    for name in figures:
        ElementTree.parse(tmp_path / "sheet" / name)
    page = (tmp_path / "sheet" / "identify.html").read_text()
    assert page.count("data:image/svg+xml,") == len(figures) and 'src="http' not in page
    (tmp_path / "vehicle.toml").write_text(
        (tmp_path / "sheet" / "drive.toml").read_text() + '\n[sensors.depth]\ntype = "depth"\n'
    )
    drive = nf.read_vehicle(tmp_path).drive
    white = drive.noise.white
    # ten minutes know the white noise to 0.5 %
    assert drive.rate_hz == RATE and white[0] == pytest.approx(WHITE, rel=0.03)
    assert white[4] == pytest.approx(1e-3, rel=0.03)
    assert drive.noise.start[0] == pytest.approx(1e-3, rel=0.1)


def test_numbers_of_the_sheet(still, capsys):
    assert main(["identify", str(still / "still.csv"), *HOW, "--json"]) == 0
    said = capsys.readouterr()
    assert said.err == "" and "NaN" not in said.out and "Infinity" not in said.out
    found = json.loads(said.out)
    assert found["at_rest"] and found["share"] == 1.0 and list(found["axes"]) == list(NAMES)
    white = found["axes"]["gyro_y"]["sheet"]["white"]
    assert white["unit"] == "deg/sqrt(h)" and white["value_in_unit"] == pytest.approx(0.3, abs=5 * white["sd_in_unit"])
    allan = found["axes"]["accel_x"]["allan"]
    assert {len(values) for values in allan.values()} == {len(allan["tau_s"])}
    assert found["drive_toml"].startswith("# From still.csv: at rest throughout")


def test_a_record_in_motion_is_exit_code_1(tmp_path, capsys):
    samples = unit_at_rest(120) + np.repeat(np.random.default_rng(1).uniform(0.01, 1.0, 240), 25)[
        :, None
    ] * np.random.default_rng(2).standard_normal((6000, 6))
    table = np.column_stack([samples[:, :3], samples[:, 3:]])
    np.savetxt(tmp_path / "car.csv", table, delimiter=",", header="wx,wy,wz,ax,ay,az", comments="")
    how = ["--imu", "--rate-hz", "50", "--gyro-unit", "rad/s", "--accel-unit", "m/s^2", "--quiet"]
    assert main(["identify", str(tmp_path / "car.csv"), *how]) == 1
    said = capsys.readouterr()
    assert said.out == "" and "not at rest" in said.err and said.err.count("\n") == 1


@pytest.mark.parametrize(
    "how, words",
    [
        (["--imu", "--rate-hz", "50"], "say in which unit gyro_x, gyro_y, gyro_z are: --gyro-unit U"),
        (["--imu", "--gyro-unit", "deg/s"], "give the sampling rate with --rate-hz, or the time with --time-column"),
        ([*HOW, "--gyro", "a,b,c"], 'there is no column "a"'),
        ([*HOW, "--accel-unit", "deg"], '"deg" is no unit of an acceleration'),
        ([*HOW, "--from-s", "900"], "has no samples from 900 to inf s: it lasts from 0 to 599.98 s"),
        (["--column", "gyro_x", "--rate-hz", "50"], "--out DIR is needed"),
        ([*HOW, "--online"], "leave --imu and --json out"),
    ],
)
def test_command_says_what_is_missing(still, capsys, how, words):
    assert main(["identify", str(still / "still.csv"), *how]) == 2
    said = capsys.readouterr()
    assert said.out == "" and words in said.err


def test_units_of_counts_are_numbers_with_a_unit(still, capsys):
    with pytest.raises(SystemExit) as stopped:
        main(["identify", str(still / "still.csv"), "--imu", "--gyro-unit", "0.05 degs"])
    assert stopped.value.code == 2 and 'unknown unit "degs"' in capsys.readouterr().err
    with pytest.raises(SystemExit):
        main(["identify", str(still / "still.csv"), "--imu", "--gyro", "a,b"])
    assert "must be three columns X,Y,Z, found 'a,b'" in capsys.readouterr().err


def test_one_series_as_json_without_a_folder(still, capsys):
    how = ["--column", "gyro_x", "--rate-hz", "50", "--unit", "deg/s", "--order", "0,0", "--json"]
    assert main(["identify", str(still / "still.csv"), *how]) == 0
    assert json.loads(capsys.readouterr().out)["best"] == {"p": 0, "d": 0, "q": 0}


def test_a_mission_and_a_part_of_it(tmp_path):
    samples = unit_at_rest(300)
    columns = ("rate_x_rad_s", "rate_y_rad_s", "rate_z_rad_s", "force_x_m_s2", "force_y_m_s2", "force_z_m_s2")
    stream = Stream(100.0 + np.arange(len(samples)) / RATE, samples, columns)
    path = Mission("still", {"imu": stream, "depth": Stream([0.0, 1.0], [1.0, 1.0], ("depth_m",))}).save(
        tmp_path / "m.npz"
    )
    found = read_imu(path)
    assert found.names == NAMES and found.rate_hz == pytest.approx(RATE) and found.begin_s == 100.0
    np.testing.assert_array_equal(found.value, samples)
    assert len(found.part(200.0, None).value) == 10_000
    with pytest.raises(MissionError, match="is no inertial unit"):
        read_imu(f"{path}:depth")


@pytest.mark.parametrize(
    "header",
    [
        "t,gx,gy,gz,ax,ay,az",
        "t,wx,wy,wz,fx,fy,fz",
        "t,Gyro X [deg/s],Gyro Y [deg/s],Gyro Z [deg/s],Acc X [g],Acc Y [g],Acc Z [g]",
        "t,imu.angular_velocity.x,imu.angular_velocity.y,imu.angular_velocity.z,"
        "imu.linear_acceleration.x,imu.linear_acceleration.y,imu.linear_acceleration.z",
        "t,xgyro,ygyro,zgyro,xacc,yacc,zacc",
        "t,gyro[0],gyro[1],gyro[2],accel[0],accel[1],accel[2]",
    ],
)
def test_columns_are_found_by_their_names(tmp_path, header):
    rows = np.column_stack([np.arange(200) / 100.0, np.random.default_rng(1).normal(size=(200, 5)), np.full(200, -1.0)])
    rows[:, 4:6] = 0.0
    np.savetxt(tmp_path / "x.csv", rows, delimiter=",", header=header, comments="")
    found = read_imu(tmp_path / "x.csv", ImuColumns(gyro_unit="deg/s", time_column="t"))
    assert found.names == NAMES
    assert found.value[:, 5] == pytest.approx(-9.80665) and found.value[7, 1] == pytest.approx(np.radians(rows[7, 2]))


def test_stamps_of_an_emptied_buffer_are_counted():
    """Samples at 100 Hz that were stamped four at a time, 1 ms apart; then a real gap."""
    t = np.repeat(np.arange(250) * 0.04, 4) + np.tile([0.0, 0.001, 0.002, 0.003], 250)
    t[600:] += 5.0
    series = on_a_grid("x", t, np.arange(1000.0), None)
    assert series.rate_hz == pytest.approx(100.0, rel=0.02) and "the stamps come in bursts" in series.notes[0]
    assert np.isnan(series.value).sum() == pytest.approx(500, rel=0.05)


def test_value_and_its_uncertainty_end_at_the_same_digit():
    assert plus_minus(0.30041, 0.00123) == "0.3004 +- 0.0012" and plus_minus(5.0, float("nan")) == "5.000 +- nan"


# --- recordings -----------------------------------------------------------------------------------------------------


def test_an_adis16405_has_the_figures_of_its_data_sheet(data_file):
    """Data sheet: angle random walk 2.0 deg/sqrt(h), velocity random walk 0.2 m/s/sqrt(h), bias stability 25 deg/h."""
    file = data_file("imu-adis16405-static/adis16405_unit1.npz")
    columns = ImuColumns(("0", "1", "2"), ("3", "4", "5"), "0.05 deg/s", "0.00333 g", rate_hz=100.0)
    found = read_imu(file, columns, TableOptions(table="counts")).part(0.0, 2500.0)
    sheet = noise_sheet(found)
    assert sheet.share > 0.99 and not sheet.moving
    for axis in sheet.axes[:3]:
        assert 1.8 < axis.sheet.terms[0].size / DEG * 60.0 < 2.8
        k = axis.allan.lowest
        assert 12.0 < axis.allan.deviation[k] / DEG * HOUR < 50.0
        assert axis.step == pytest.approx(0.05 * DEG)
    assert all(0.15 < axis.sheet.terms[0].size * 60.0 < 0.32 for axis in sheet.axes[3:])
    # of white noise the Allan deviation at 1 s is N; the README of the recording has 0.0409 deg/s for gyro x
    curve = sheet.axes[0].allan
    at_1_s = float(np.interp(1.0, curve.tau_s, curve.deviation)) / DEG
    assert at_1_s == pytest.approx(0.0409, rel=0.02)


def test_static_recordings_are_at_rest_and_a_car_is_not(data_file, recording):
    dot = noise_sheet(read_imu(data_file("imu-xsens-dot-static/x_stat_2.csv.xz"), ImuColumns((), (), "deg/s", "", "0")))
    assert dot.share > 0.95 and not dot.moving  # the first second is the sensor's start
    mems = read_imu(
        data_file("imu-mag-mpu6050-hmc5883l-static/unmoved_10min_mpu6050_gyroscope.mat"),
        ImuColumns(("1", "2", "3"), (), "deg/s", "", "0"),
    )
    assert mems.rate_hz == pytest.approx(99.3, abs=0.2) and noise_sheet(mems).share == 1.0
    for name in ("comma2k19/segment40", "wid-car-rtk/02", "sonia-auv-pool/20160305_SQUARE"):
        with pytest.raises(NotAtRest):
            noise_sheet(read_imu(recording(name)))


def test_logs_with_an_inertial_unit_are_read_without_a_word_more(log_sample):
    pytest.importorskip("rosbags", reason='rosbags is not installed: pip install "navfilter[ros]"')
    found = read_imu(log_sample("ros1/robot_localization_test2.bag"))
    assert found.names == NAMES and len(found.value) == 3061 and found.notes[0] == "/imu/data is taken"
    assert np.nanmean(found.value[:, 5]) == pytest.approx(-9.8, abs=0.3)
    with pytest.raises(NotAtRest, match="no stretch of half a minute in 61 s"):
        noise_sheet(found)


def test_every_row_of_the_sheet_is_in_the_text(still):
    found = noise_sheet(read_imu(still / "still.csv", ImuColumns((), (), "deg/s", "", "t_ms", "ms")))
    text = sheet_text(found)
    for words in (
        "velocity random walk [m/s/sqrt(h)]",
        "bias instability (flicker B) [ug]",
        "Allan deviation at 100 s",
    ):
        assert words in text
    assert re.search(r"rate random walk \[deg/h/sqrt\(h\)\] +\d+ \+- \d+", text)
