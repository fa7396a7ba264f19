"""The batch kernels against their readable twins."""

import naive
import numpy as np
import pytest
from scipy.linalg import solve_discrete_lyapunov

from navfilter.kernels import arma_fit as kernels

RANDOM = np.random.default_rng(20)
A = np.poly([0.95, 0.6, -0.4])[1:]
C = np.poly([0.8, 0.5j, -0.5j]).real[1:]


def both(name, *arguments, outputs):
    """Run kernel and twin on copies; return the pairs of outputs and of returned values."""
    first = [x.copy() if isinstance(x, np.ndarray) else x for x in arguments]
    second = [x.copy() if isinstance(x, np.ndarray) else x for x in arguments]
    returned = getattr(kernels, name)(*first), getattr(naive, name)(*second)
    pairs = [(first[i], second[i]) for i in outputs]
    return [*pairs, returned] if returned[0] is not None else pairs


@pytest.mark.parametrize(
    ("name", "arguments", "outputs"),
    [
        ("arma_filter", (RANDOM.normal(size=200), A, C, RANDOM.normal(size=3), np.empty(200)), (3, 4)),
        ("lag_products", (RANDOM.normal(size=103), RANDOM.normal(size=103), np.empty(7)), (2,)),
        ("lag_products", (RANDOM.normal(size=5), RANDOM.normal(size=5), np.empty(9)), (2,)),
        ("inner_products", (RANDOM.normal(size=(3, 101)), np.empty((3, 3))), (1,)),
        (
            "without_inputs",
            (RANDOM.normal(size=50), RANDOM.normal(size=(2, 50)), np.array([2.0, -1.0]), np.empty(50)),
            (3,),
        ),
        ("shift_gram", (RANDOM.normal(size=60), RANDOM.normal(size=60), 1, np.empty((4, 3))), (3,)),
        ("shift_gram", (RANDOM.normal(size=60), RANDOM.normal(size=60), 0, np.empty((2, 5))), (3,)),
        ("lyapunov", (np.diag([0.9, 0.5]) + np.eye(2, k=1), np.eye(2), 5, np.empty((2, 2))), (3,)),
        ("largest_reflection", (A, 1.0), ()),
        ("largest_reflection", (A, 0.97), ()),
        ("largest_reflection", (A, 0.94), ()),
        ("levinson", (np.array([2.0, 1.2, 0.5, 0.1]), np.zeros(3), np.empty(3)), (1, 2)),
        ("burg_recursion", (RANDOM.normal(size=80), np.zeros(4)), (1,)),
    ],
)
def test_kernel_equals_twin(name, arguments, outputs):
    pairs = both(name, *arguments, outputs=outputs)
    assert pairs
    for kernel, twin in pairs:
        # Only the order of summation differs.
        np.testing.assert_allclose(kernel, twin, rtol=1e-10, atol=1e-11)


def test_impulse_response_equals_twin_and_says_where_it_ends():
    fast, slow = np.empty(400), np.empty(400)
    length = kernels.impulse_response(C, fast)
    naive.impulse_response(C, slow)
    np.testing.assert_allclose(fast, slow, atol=1e-15)
    assert 100 < length < 400 and np.abs(slow[length:]).max() < 1e-16


@pytest.mark.parametrize("missing", [False, True])
def test_kalman_whiten_equals_textbook_filter(missing):
    Y = RANDOM.normal(size=(300, 2))
    if missing:
        Y[40:55, 0] = np.nan
        Y[100, 0] = np.nan
    M = np.eye(3, k=1)
    M[:, 0] -= A
    P0 = solve_discrete_lyapunov(M, np.outer(C - A, C - A))
    (fast, slow), (logdet, expected) = both("kalman_whiten", Y, A, C, P0, np.empty_like(Y), outputs=(4,))
    # The steady-state switch drops a covariance below 1e-13.
    np.testing.assert_allclose(fast, slow, atol=1e-10)
    assert logdet == pytest.approx(expected, abs=1e-10)


@pytest.mark.parametrize("distance", [0.0, 0.003, 0.2])
@pytest.mark.parametrize(("p", "q"), [(0, 1), (1, 0), (1, 1), (2, 3), (5, 4)])
def test_confine_equals_twin_and_keeps_what_is_within(p, q, distance):
    """Roots anywhere, also beyond the circle, at 0 and close to 1; near each other they are less well determined."""
    limits = np.array([distance, 0.999, 0.9995, -14.0, 40.0, -3.0, 2.0])

    def some(n):
        pairs = RANDOM.uniform(0.1, 1.2, n // 2) * np.exp(1j * RANDOM.uniform(0.0, np.pi, n // 2))
        return np.concatenate([pairs, pairs.conj(), RANDOM.choice([0.0, -0.4, 0.97, 0.9995, 1.001, 1.3], n % 2)])

    def coefficients(n):
        return np.atleast_1d(np.poly(some(n))).real[1:]

    rows = np.array([np.r_[coefficients(p), coefficients(q), RANDOM.uniform(-50.0, 50.0, 2)] for _ in range(100)])
    found, expected = rows.copy(), rows.copy()
    kernels.confine(found, p, q, limits)
    naive.confine(expected, p, q, limits)
    np.testing.assert_allclose(found, expected, atol=1e-6)
    assert found[:, -2:].min() >= -14.0 and found[:, -1].max() <= 2.0
    for row, before in zip(found, rows, strict=True):
        poles, zeros, old = (np.roots(np.r_[1.0, part]) for part in (row[:p], row[p : p + q], before[:p]))
        assert np.all(np.abs(poles) < 0.999 + 1e-6) and np.all(np.abs(zeros) < 0.9995 + 1e-6)
        # one from outside, too: a fast part with a pole at 1 is an error that never ends
        assert np.all(np.abs(np.log(poles[np.abs(poles) > 0.1].astype(complex))) > 0.99 * distance)
        far = np.abs(np.log(old[np.abs(old) > 0.1].astype(complex))) > 1.01 * distance
        if np.all(far) and np.all(np.abs(old) < 0.998):
            np.testing.assert_array_equal(row[:p], before[:p])
