"""Radii of circles against draws, and orders of S-44 by the way."""

import json
from dataclasses import replace

import numpy as np
import pytest
from small_run import small_run

from navfilter.evaluation.assessment import ORDERS, radius, survey_figures


@pytest.mark.parametrize("share", [0.5, 0.95])
@pytest.mark.parametrize("small", [0.0, 0.013, 0.3, 0.8, 1.0])
def test_a_circle_holds_as_many_as_it_says(share, small):
    turn = np.array([[0.8, -0.6], [0.6, 0.8]])
    covariance = turn @ np.diag([small**2, 4.0]) @ turn.T
    drawn = np.random.default_rng(1).multivariate_normal(np.zeros(2), covariance, 200_000)
    inside = np.hypot(*drawn.T) < radius(covariance[np.newaxis], share)
    assert inside.mean() == pytest.approx(share, abs=0.004)


def test_orders_count_by_the_way_not_by_the_time():
    _, tracks = small_run()
    track = list(tracks.values())[-1]
    half = int(np.searchsorted(track.travelled(), 0.5 * track.distance_m))
    covariance = np.zeros_like(track.covariance)
    covariance[:half, :3, :3] = np.diag([0.1, 0.1, 0.05]) ** 2
    covariance[half:, :3, :3] = np.diag([3.0, 3.0, 0.1]) ** 2
    found = survey_figures(replace(track, covariance=covariance))
    assert list(found.orders) == list(ORDERS)
    assert found.orders["exclusive"] == pytest.approx(50.0, abs=1.0) == found.orders["special"] == found.orders["1a/1b"]
    assert found.orders["2"] == pytest.approx(100.0)
    assert found.r95_most_m == pytest.approx(3.0 * 2.4477, rel=1e-3) and found.tvu_most_m == pytest.approx(
        0.196, abs=1e-3
    )
    assert json.loads(json.dumps(found.to_dict()))["orders"]["2"] == pytest.approx(100.0)
    assert any("R95" in line for line in found.lines())
    assert found.horizontal == found.orders and "horizontally" not in "".join(found.lines())


def test_without_depths_the_orders_are_told_horizontally():
    _, tracks = small_run()
    track = list(tracks.values())[-1]
    covariance = np.zeros_like(track.covariance)
    covariance[:, :3, :3] = np.diag([0.5, 0.5, 100.0]) ** 2
    found = survey_figures(replace(track, covariance=covariance))
    assert set(found.orders.values()) == {0.0} and found.horizontal["special"] == pytest.approx(100.0)
    assert "horizontally alone: exclusive 0 %, special 100 %" in "".join(found.lines())
