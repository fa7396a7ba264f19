"""A velocity that jumps by about itself is used where it reads the same, and taken back once it agrees under way."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from state_differences import differences
from test_agreement import FAULT_S, altered, dive, feed, fly

import navfilter as nf
from navfilter.faults import velocity_fault
from navfilter.faults.velocity_fault import VelocityFault
from navfilter.models.fault_bias import has_offset
from navfilter.navigation import runner

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
def test_a_velocity_that_jumps_by_itself_for_a_minute_leads_nobody_off(change, mems):
    vehicle, mission = dive(mems)
    off, counts, models = judged(vehicle, altered(mission, "dvl", change, JUMP_S, JUMP_S + MINUTE_S))
    without, *_ = judged(vehicle, altered(mission, "dvl", lambda v: v * np.nan, JUMP_S, JUMP_S + MINUTE_S))
    # better than a minute without it, and known to be so
    assert off[:, 1].max() < without[:, 1].max() and (off[:, 1] < 3.0 * off[:, 2]).all()
    assert counts["jumped"] == 2 and not has_offset(models)


def test_it_is_told_and_stretches_lives_and_snapshots_give_the_same(monkeypatch):
    vehicle, mission = dive()
    mission = mission.between(0.0, JUMP_S + MINUTE_S + 10.0)
    broken = altered(mission, "dvl", about_face, JUMP_S, JUMP_S + MINUTE_S)
    whole, _ = fly(vehicle, broken)
    track = nf.replay(vehicle, broken, output_rate_hz=None)
    np.testing.assert_array_equal(track.velocity_n[-1], whole.state.velocity_n)
    monkeypatch.setattr(runner.BatchRunner, "possible", property(lambda self: False))
    np.testing.assert_array_equal(nf.replay(vehicle, broken).covariance[-1], track.covariance[-1])
    half, _ = fly(vehicle, broken, until_s=JUMP_S + 50.0)
    assert half.health.sensors["dvl"].condition == "jumped" and "dvl is jumped" in half.health.trust.reasons
    again = nf.Navigator.restore(vehicle, half.snapshot())
    feed(again, vehicle, broken, after_s=JUMP_S + 50.0)
    assert not differences(again.memory.filter, whole.memory.filter)


@pytest.mark.parametrize("change", [about_face, quarter_turn], ids=["sign", "axes"])
def test_one_that_stays_so_bounds_the_velocity(change):
    vehicle, mission = dive(True)  # a micromechanical unit is soon uncertain
    off, counts, models = judged(vehicle, altered(mission, "dvl", change, JUMP_S))
    without, *_ = judged(vehicle, altered(mission, "dvl", lambda v: v * np.nan, JUMP_S))
    assert (off[:, 1] < 3.0 * off[:, 2]).all() and off[-1, 2] < 0.7 * without[-1, 2]
    assert counts["jumped"] == 1 and has_offset(models)


SIGN = VelocityFault(1.5, (-1.5, 0.0, 0.0), (-3.0, 0.0, 0.0))


def test_what_reads_the_same_is_the_same_and_worth_the_less_the_more_it_differs():
    assert velocity_fault.unchanged(SIGN, np.array([-1.45, 0.02, np.nan]))
    assert not velocity_fault.unchanged(SIGN, np.array([-1.4, 0.0, 0.0]))  # it sails faster or slower: nobody knows
    assert not velocity_fault.unchanged(SIGN, np.full(3, np.nan))
    assert not velocity_fault.unchanged(VelocityFault(1.5, (math.nan,) * 3, (-1.5, 0.0, 0.0)), np.zeros(3))
    found = velocity_fault.widened_variances(SIGN, np.array([-1.45, 0.0, np.nan]), np.full(3, 1e-4))
    np.testing.assert_allclose(found, [1e-4 + 0.1**2, 1e-4, 1e-4])  # of another sign: twice the change


def test_it_is_back_where_it_is_nearer_to_the_state_under_way():
    assert velocity_fault.shows_itself(SIGN, 1.5, np.array([-0.7, 0.0, np.nan]))
    assert not velocity_fault.shows_itself(SIGN, 1.5, np.array([-1.6, 0.0, 0.0]))  # however uncertain the velocity is
    assert not velocity_fault.shows_itself(SIGN, 0.2, np.array([-0.4, 0.0, 0.0]))  # another sign agrees at rest


def test_a_jump_beside_the_speed_is_one_of_the_velocity_where_a_unit_carries():
    def filter(speed, lost=False, inertial=True):
        memory = SimpleNamespace(nav=np.eye(17)[3] * speed, monitor=SimpleNamespace(has_excluded=lost))
        return SimpleNamespace(memory=memory, inertial=inertial)

    def channel(reading, ground=3):
        return SimpleNamespace(ground=ground, reading=np.array(reading), axes=3)

    dvl, jump = channel([-1.5, 0.0, 0.0]), np.array([-3.0, 0.0, 0.0])
    assert velocity_fault.jumped(filter(1.5), dvl, jump) == SIGN
    assert velocity_fault.jumped(filter(1.5), dvl, 0.1 * jump) is None  # a constant, or a scale
    assert velocity_fault.jumped(filter(1.5), channel([-1.5, 0.0, 0.0], ground=0), jump) is None
    assert (
        velocity_fault.jumped(filter(1.5, lost=True), dvl, jump)
        is velocity_fault.jumped(filter(1.5, inertial=False), dvl, jump)
        is None
    )
    nothing = velocity_fault.jumped(filter(1.5), channel([0.01, 0.0, 0.0]), 0.5 * jump)
    assert np.isnan(nothing.read).all()  # it reads nothing at any speed
