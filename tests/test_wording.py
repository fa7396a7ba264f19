"""What was learnt, in words and as spectra, from models whose parts are known."""

import dataclasses
import json
import math

import numpy as np
import pytest
from small_run import small_run

from navfilter.commands.cli import main
from navfilter.evaluation.over_dives_text import Scale, error_words, in_force, learnt, model_words
from navfilter.models.error_models import Arma, ErrorModel, GaussMarkov, RandomWalk, White
from navfilter.models.interpretation import stationary_parts
from navfilter.models.learned_arma import LearnedArma
from navfilter.playback.replay import replay
from navfilter.rendering.panels import legend_of
from navfilter.report.figures import SpectrumBand, spectrum_figure
from navfilter.simulation.scenarios import simulate_scenario
from navfilter.timeseries.model import ArmaModel, add_arma

DEG = Scale("deg", 180.0 / math.pi, 8.0)
RAD = math.pi / 180.0


def swing(period_s, damping_s, sd, rate_hz=8.0):
    """An AR(2) that rings with this period."""
    radius, angle = math.exp(-1.0 / (damping_s * rate_hz)), 2.0 * math.pi / (period_s * rate_hz)
    ar = np.array([-2.0 * radius * math.cos(angle), radius**2])
    return ArmaModel(ar, [], sd / math.sqrt(ArmaModel(ar, [], 1.0).variance))


def slow(tau_s, sd, rate_hz=8.0):
    phi = math.exp(-1.0 / (tau_s * rate_hz))
    return ArmaModel([-phi], [], sd * math.sqrt(1.0 - phi**2))


def test_models_in_force_axis_by_axis():
    track = small_run()[1]["forward"]
    near, far = White(sd=0.5), GaussMarkov(sd=3.0, tau_s=60.0)
    assert in_force(track, "gps", (near, near, near)) == in_force(track, "gps", near) == "white 0.50 m"
    assert in_force(track, "gps", (near, far, near)) == "north, down: white 0.50 m; east: slow error 3.0 m over 60 s"
    waits = "to be learnt, until then white 0.50 m"
    assert (
        in_force(track, "gps", LearnedArma(prior=near)) == waits
        and in_force(track, "depth", LearnedArma()) == "to be learnt"
    )
    assert in_force(track, "nobody", (near, far)) == f"{near}; {far}"


def test_the_sum_of_three_parts_is_read_back():
    """Slow, swinging and white errors of known size, added exactly."""
    model = add_arma([slow(60.0, 0.34 * RAD), swing(6.1, 40.0, 0.35 * RAD), ArmaModel([], [], 0.1 * RAD)])
    assert model_words(model, DEG) == "slow error 0.34 deg over 60 s, swings with 6.1 s by 0.35 deg, white 0.10 deg"


def test_a_model_that_is_no_such_sum_has_its_power_by_frequency():
    """A moving average that is no white noise beside the poles: the powers are those of the bands, and add up."""
    both = add_arma([slow(60.0, 0.3 * RAD), swing(6.1, 40.0, 0.4 * RAD)])
    model = ArmaModel(both.ar, [0.5, 0.3], both.sd)
    assert not any(math.isfinite(part.sd) for part in stationary_parts(model, 8.0))
    words = model_words(model, DEG)
    sizes = [float(word.split(" deg")[0].split()[-1]) for word in words.split(", ")]
    assert words.startswith("slow error") and "swings with 6.1 s" in words
    # two digits of each size are printed
    np.testing.assert_allclose(np.sum(np.square(sizes)), model.variance / RAD**2, rtol=0.08)


@pytest.mark.parametrize(
    ("model", "words"),
    [
        (White(sd=0.005), "white 0.29 deg"),
        (White(density=0.01 * RAD), "white 0.028 deg"),
        (GaussMarkov(sd=0.5 * RAD, tau_s=1.75), "slow error 0.50 deg over 1.8 s"),
        (RandomWalk(density=1e-3 * RAD), "wanders by 0.060 deg in an hour"),
        (White(sd=0.1 * RAD) + GaussMarkov(sd=1.0 * RAD, tau_s=300.0), "white 0.10 deg, slow error 1.0 deg over 300 s"),
        (Arma(ar=[0.9], sd=0.1 * RAD), "alternates from reading to reading by 0.23 deg"),
        (LearnedArma(model=slow(60.0, 1.0 * RAD)), "slow error 1.0 deg over 60 s"),
        (
            LearnedArma(model=slow(2.0, 1.0 * RAD), slow=GaussMarkov(0.5 * RAD, 60.0) + White(sd=0.1 * RAD)),
            "slow error 0.50 deg over 60 s, white 0.10 deg, slow error 1.0 deg over 2.0 s",
        ),
    ],
)
def test_error_models_in_words(model, words):
    assert error_words(model, DEG) == words


@dataclasses.dataclass(frozen=True)
class Own(ErrorModel):
    """A user's own kind."""

    def block(self, period_s):
        return White(sd=1.0).block(period_s)


def test_a_foreign_kind_prints_itself():
    assert error_words(Own() + White(sd=1.0), Scale("m", 1.0, 1.0)) == "Own(), white 1.0 m"


@pytest.fixture(scope="module")
def dive():
    """Ten minutes with a compass that learns, and believes wrongly."""
    vehicle, mission = simulate_scenario("oscillating", 1, 600.0)
    prior = GaussMarkov(sd=0.5 * RAD, tau_s=1.75)
    learning = LearnedArma(prior=prior, window=2000, hop=1000)
    return vehicle.with_error(compass=White(sd=0.01 * RAD) + learning), mission


def test_a_run_says_what_it_learnt_and_believed(dive):
    track = replay(*dive, output_rate_hz=1.0)
    (found,) = learnt(track)
    assert found.title == "compass" and len(found.models) == len(track.adopted()["compass"])
    said = str(found)
    assert said.startswith("compass: slow error") and "swings with 6." in said
    assert said.endswith("white 0.010 deg; vehicle.toml believed white 0.010 deg, slow error 0.50 deg over 1.8 s")
    assert found.to_dict()["history"][-1][1] == error_words(found.adopted[-1], found.scale)
    assert found.to_dict()["history"][-1][1].endswith(model_words(found.models[-1], found.scale))
    assert learnt(replay(dive[0].with_error(compass=White(sd=0.01)), dive[1], output_rate_hz=1.0)) == ()


def test_spectra_show_what_was_believed_and_the_posterior(dive):
    (found,) = learnt(replay(*dive, output_rate_hz=1.0))
    freq_hz = np.linspace(0.0, 4.0, 40_001)[1:]
    unit = found.scale.factor**2
    # sums over 40 000 steps; what is believed is 1/f^2 from 0.1 Hz on, and resolved
    believed = found.believed_spectrum(freq_hz)
    np.testing.assert_allclose(np.sum(believed) * 1e-4, unit * ((0.5 * RAD) ** 2 + (0.01 * RAD) ** 2), rtol=2e-2)
    at, low, median, high = found.spectrum
    assert np.all((low <= median) & (median <= high)) and at[-1] == 4.0
    # around the swing of 6 s the fast part is nearly all there is, and well known; at low frequencies little is
    spectrum = found.models[-1].spectrum(at, 8.0)
    swing = (at > 0.12) & (at < 0.2)
    # half of it is handed out, beside half of what was believed: sums over a minute tell nothing of such a swing
    np.testing.assert_allclose(0.5 * median[swing], unit * spectrum[swing], rtol=0.1)
    assert np.all(high[swing] / low[swing] < 3.0) and high[0] / low[0] > 3.0
    assert [part.label for part in legend_of(spectrum_figure(found), 0)] == ["5 to 95 %", "believed", "learnt"]
    # a model that came from a file has no posterior: what was believed is still shown
    kept = dataclasses.replace(found, adopted=(dataclasses.replace(found.adopted[-1], spectrum=None),))
    assert [part.label for part in legend_of(spectrum_figure(kept), 0)] == ["believed"]
    given = SpectrumBand(at, low, median, 3.0 * median)
    band, _, line = spectrum_figure(found, given).panels[0].parts
    np.testing.assert_array_equal(band.high, 3.0 * line.y)


def test_console_summary_and_report_say_it(dive, tmp_path, capsys):
    vehicle, mission = dive
    mission.save(tmp_path / "m.npz")
    from navfilter.io import write_vehicle

    write_vehicle(vehicle, tmp_path / "vehicle.toml")
    main(["replay", str(tmp_path / "m.npz"), "--vehicle", str(tmp_path), "--out", str(tmp_path / "out")])
    said = capsys.readouterr().out
    line = next(line for line in said.splitlines() if line.startswith("learnt: compass: "))
    words = json.loads((tmp_path / "out" / "summary.json").read_text())["learnt"]["compass"]["words"]
    page = (tmp_path / "out" / "report.html").read_text()
    assert words in line and words in page and "What was learnt" in page
