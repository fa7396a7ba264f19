"""A velocity that jumps by about itself is set aside, and taken back once it agrees while the vehicle moves."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from test_agreement import FAULT_S, altered, dive, feed, fly

import navfilter as nf
from navfilter import passage
from navfilter.filter import aside
from navfilter.filter.memory import differences
from navfilter.filter.offsets import has_offset
from navfilter.filter.refusals import LEAST, Refusals

JUMP_S, MINUTE_S = FAULT_S + 20.0, 60.0  # under way


def about_face(velocity):
    return -velocity


def quarter_turn(velocity):
    return velocity[:, [1, 0, 2]] * [-1.0, 1.0, 1.0]


def judged(vehicle, mission):
    """The replayed track from the fault on: time, horizontal error and its sd; what was counted, models at the end."""
    track = nf.replay(vehicle, mission, output_rate_hz=1.0)
    late = track.time_s > FAULT_S
    sd = np.sqrt(track.covariance[late, 0, 0] + track.covariance[late, 1, 1])
    figures = np.column_stack([track.time_s[late], track.errors(mission.truth).horizontal[late], sd])
    return figures[np.isfinite(figures[:, 1])], track.counts, track.error_models["dvl"][-1][1]


@pytest.mark.parametrize("change", [about_face, quarter_turn, lambda v: 1.944 * v], ids=["sign", "axes", "knots"])
@pytest.mark.parametrize("mems", [False, True])
def test_a_velocity_that_jumps_by_itself_for_a_minute_is_not_used_meanwhile(change, mems):
    vehicle, mission = dive(mems)
    off, counts, models = judged(vehicle, altered(mission, "dvl", change, JUMP_S, JUMP_S + MINUTE_S))
    without, *_ = judged(vehicle, altered(mission, "dvl", lambda v: v * np.nan, JUMP_S, JUMP_S + MINUTE_S))
    # what a minute without it costs, and what is said of that
    assert off[:, 1].max() < 1.5 * without[:, 1].max() and (off[:, 1] < 3.0 * off[:, 2]).all()
    assert off[-1, 2] < 1.1 * without[-1, 2]
    assert counts["jumped"] >= 1 and not has_offset(models)


def test_it_is_told_and_stretches_lives_and_snapshots_give_the_same(monkeypatch):
    vehicle, mission = dive()
    mission = mission.between(0.0, JUMP_S + MINUTE_S + 10.0)
    broken = altered(mission, "dvl", about_face, JUMP_S, JUMP_S + MINUTE_S)
    whole, _ = fly(vehicle, broken)
    track = nf.replay(vehicle, broken, output_rate_hz=None)
    np.testing.assert_array_equal(track.velocity_n[-1], whole.state.velocity_n)
    monkeypatch.setattr(passage.Passage, "possible", property(lambda self: False))
    np.testing.assert_array_equal(nf.replay(vehicle, broken).covariance[-1], track.covariance[-1])
    half, _ = fly(vehicle, broken, until_s=JUMP_S + 50.0)
    assert half.health.sensors["dvl"].condition == "astray" and "dvl is astray" in half.health.trust.reasons
    again = nf.Navigator.restore(vehicle, half.snapshot())
    feed(again, vehicle, broken, after_s=JUMP_S + 50.0)
    assert not differences(again.memory.filter, whole.memory.filter)


@pytest.mark.parametrize("change", [about_face, quarter_turn], ids=["sign", "axes"])
def test_one_that_stays_so_bounds_the_velocity_in_the_end(change):
    vehicle, mission = dive(True)  # a micromechanical unit is soon uncertain
    off, counts, models = judged(vehicle, altered(mission, "dvl", change, JUMP_S))
    without, *_ = judged(vehicle, altered(mission, "dvl", lambda v: v * np.nan, JUMP_S))
    assert (off[:, 1] < 3.0 * off[:, 2]).all() and off[-1, 2] < 0.7 * without[-1, 2]
    assert counts["jumped"] >= 1 and has_offset(models)


def refusals(size, back=0):
    return Refusals(True, True, (size,), (size, 0.0, 0.0), (0.1,) * 3, (0.1,) * 3, 0.0, 2.0, 9, aside=True, back=back)


def test_what_agrees_at_rest_is_used_and_proves_nothing():
    def at(speed, sd):
        memory = SimpleNamespace(nav=np.eye(17)[3] * speed, P=np.diag(np.full(9, sd**2)))
        return SimpleNamespace(memory=memory)

    channel = SimpleNamespace(res=np.array([0.01, 0.0, np.nan]), limits=np.array([math.inf, 15.0, 18.0, 21.0]))
    refused = refusals(-3.0)
    for _ in range(LEAST):
        assert not aside.is_back(at(0.0, 0.1), refused)[0]
        refused = aside.heard(channel, refused, 2.0, 2)
    assert aside.is_back(at(0.0, 0.1), refused) == (True, False)
    assert aside.is_back(at(1.5, 0.1), refused) == (True, True)
    channel.res[0] = -1.6  # nearer to the jump than to none: the velocity may be as uncertain as it likes
    assert aside.heard(channel, refused, 2.0, 2).back == 0
    assert not aside.better_than_nothing(at(1.5, 0.5), refused) and aside.better_than_nothing(at(1.5, 0.7), refused)


def test_a_jump_beside_the_speed_is_set_aside_where_a_unit_carries():
    def filter(speed, lost=False, inertial=True):
        watch = SimpleNamespace(lost=lambda w: lost)
        memory = SimpleNamespace(nav=np.eye(17)[3] * speed, watch=None)
        return SimpleNamespace(memory=memory, inertial=inertial, watch=watch)

    dvl, wheels = (SimpleNamespace(sensor=SimpleNamespace(gives=name)) for name in ("velocity", ""))
    assert aside.worthless(filter(1.5), dvl, refusals(3.0)) and not aside.worthless(filter(1.5), dvl, refusals(0.3))
    assert not aside.worthless(filter(1.5), wheels, refusals(3.0))
    assert not aside.worthless(filter(1.5, lost=True), dvl, refusals(3.0))
    assert not aside.worthless(filter(1.5, inertial=False), dvl, refusals(3.0))
