"""The online ARMA kernels against their NumPy twins."""

import naive
import numpy as np
import pytest

from navfilter.kernels import recursive_arma, recursive_arma_window
from navfilter.timeseries.model import simulate_arma

ORDERS = [(1, 0), (0, 1), (1, 1), (2, 1), (1, 3), (4, 2), (0, 3)]
AR = {0: [], 1: [-0.8], 2: [-1.2, 0.5], 4: [-0.5, 0.2, 0.1, -0.3]}
MA = {0: [], 1: [0.4], 2: [0.4, 0.3], 3: [0.3, -0.2, 0.1]}
LAM = 0.999


def state(p, q, length):
    n = p + q
    s = np.zeros((recursive_arma.COV + n, recursive_arma.WIDTH))
    head = s[recursive_arma.HEAD]
    head[[recursive_arma.AR, recursive_arma.MA, recursive_arma.DUE]] = p, q, length
    head[[recursive_arma.LAM, recursive_arma.LAM_END, recursive_arma.LAM_RATE]] = LAM, LAM, 0.99
    head[[recursive_arma.RADIUS_A, recursive_arma.RADIUS_C, recursive_arma.VAR, recursive_arma.UNIT]] = (
        0.99999,
        0.99999,
        1.0,
        1.0,
    )
    head[[recursive_arma.CAP, recursive_arma.RUNNING]] = 1e9, 1.0
    s[recursive_arma.COV :, :n] = 0.01 * np.eye(n)
    return s, np.zeros((1, length))


@pytest.mark.parametrize(("p", "q"), ORDERS)
def test_rml_run_equals_its_twin(p, q):
    xs = simulate_arma(AR[p], MA[q], 1.0, 300, seed=p + 10 * q)
    s, buf = state(p, q, 300)
    recursive_arma.rml_run(s, buf, xs, 0)
    theta, P = naive.rml_run(p, q, xs, np.zeros(p + q), 0.01 * np.eye(p + q), LAM)
    # Same recursion in another order of summation: rounding grows a little over 300 steps.
    np.testing.assert_allclose(s[recursive_arma.THETA, : p + q], theta, rtol=0, atol=1e-10)
    np.testing.assert_allclose(s[recursive_arma.COV :, : p + q], P, rtol=1e-8, atol=1e-14)


def test_rml_step_is_rml_run_bit_for_bit():
    xs = simulate_arma(AR[2], MA[1], 1.0, 200, seed=3)
    one, buf_one = state(2, 1, 200)
    many, buf_many = state(2, 1, 200)
    for x in xs:
        recursive_arma.rml_step(one, buf_one, x)
    recursive_arma.rml_run(many, buf_many, xs, 0)
    assert np.array_equal(one, many)
    assert np.array_equal(buf_one, buf_many)


def test_covariance_stays_symmetric_to_the_last_bit():
    # The skew part of P grows like lam^-t: were it not zero, ten windows would ruin the estimate.
    xs = simulate_arma(AR[4], MA[2], 1.0, 3000, seed=5)
    s, buf = state(4, 2, 3000)
    recursive_arma.rml_run(s, buf, xs, 0)
    P = s[recursive_arma.COV :, :6]
    assert np.array_equal(P, P.T)


@pytest.mark.parametrize("call", ["bank_run", "bank_step"])
def test_bank_equals_its_members_alone(call):
    orders = [(1, 1), (2, 0), (0, 1)]
    xs = simulate_arma(AR[1], MA[1], 1.0, 150, seed=7)
    states = np.zeros((3, recursive_arma.COV + 2, recursive_arma.WIDTH))
    bufs = np.zeros((3, 1, 150))
    for i, (p, q) in enumerate(orders):
        s, _ = state(p, q, 150)
        states[i, : s.shape[0]] = s
    if call == "bank_run":
        assert recursive_arma.bank_run(states, bufs, xs, 0) == 150
    else:
        due = [recursive_arma.bank_step(states, bufs, x) for x in xs]
        assert due == [False] * 149 + [True]
    thetas, Ps = [np.zeros(p + q) for p, q in orders], [0.01 * np.eye(p + q) for p, q in orders]
    for i, (theta, _) in enumerate(getattr(naive, call)(orders, xs, thetas, Ps, LAM)):
        np.testing.assert_allclose(states[i, recursive_arma.THETA, : theta.size], theta, rtol=0, atol=1e-10)


def run_pass(theta, p, q, y, lo):
    r = max(p, q)
    n = p + q
    work, normal = np.full((5, r + y.size), 7.0), np.zeros((n + 1, n + 1))
    carry = np.zeros((3, recursive_arma.WIDTH))
    used = recursive_arma_window.window_pass(theta, p, y[None].copy(), (lo, y.size), carry, work, normal)
    return used, work, normal, carry


@pytest.mark.parametrize(("p", "q"), ORDERS)
def test_window_pass_equals_its_twin(p, q):
    theta = np.r_[AR[p], MA[q]]
    y = simulate_arma(AR[p], MA[q], 1.0, 517, seed=1)
    used, _, normal, _ = run_pass(theta, p, q, y, 100)
    assert used == 417
    np.testing.assert_allclose(normal, naive.window_pass(theta, p, y, 100), rtol=1e-10, atol=1e-9)


@pytest.mark.parametrize(("p", "q"), ORDERS)
def test_memory_carries_a_pass_on(p, q):
    theta = np.r_[AR[p], MA[q]]
    y = simulate_arma(AR[p], MA[q], 1.0, 400, seed=2)
    _, work, _, carry = run_pass(theta, p, q, y, 50)
    recursive_arma_window.memory_after(150, p, q, work, carry)
    phi, psi, more = naive.memory_after(theta, p, y, 150)
    np.testing.assert_allclose(carry[0, : p + q], phi, atol=1e-12)
    np.testing.assert_allclose(carry[1, : p + q], psi, atol=1e-12)
    np.testing.assert_allclose(carry[2, : max(q - p, 0)], more, atol=1e-12)
    r = max(p, q)
    rest, normal = np.zeros((5, r + 250)), np.zeros((p + q + 1, p + q + 1))
    recursive_arma_window.window_pass(theta, p, y[None, 150:].copy(), (0, 250), carry, rest, normal)
    np.testing.assert_allclose(rest[1, r:], work[1, r + 150 :], atol=1e-12)


@pytest.mark.parametrize(("p", "q"), [(1, 1), (2, 1), (4, 2), (0, 3)])
def test_polish_and_covariance_equal_their_twins(p, q):
    y = simulate_arma(AR[p], MA[q], 1.0, 2000, seed=4)
    theta = np.zeros(p + q)
    work, normal = np.zeros((5, max(p, q) + 2000)), np.zeros((p + q + 1, p + q + 1))
    carry, limits = np.zeros((3, recursive_arma.WIDTH)), np.array([0.9999, 0.9995, 60.0])
    used, settled = recursive_arma_window.polish(theta, p, y[None].copy(), (200, 2000), carry, work, normal, limits)
    assert (used, settled) == (1800, 1)
    n = p + q
    out = np.empty((n, n))
    assert recursive_arma_window.window_covariance(normal, n, out)
    np.testing.assert_allclose(out, naive.window_covariance(normal, n), rtol=1e-6)
    best = naive.polish(np.r_[AR[p], MA[q]], p, y, 200)
    # The polish stops when 0.01 standard deviations are left.
    assert np.all(np.abs(theta - best) < 0.02 * np.sqrt(np.diag(out) * normal[n, n] / used))
