"""Properties of the filter kernels that the twins do not show: definiteness, invariance, and one compiled signature
each.
"""

import numpy as np
import pytest
from kernel_inputs import random_nav, spd

from navfilter.kernels import kalman


def correction(P, H, R, res, nav):
    n, a = len(P), len(res)
    S, PH, K, out, turn = np.zeros((2 * a, a)), np.zeros((a, n)), np.zeros((n, a)), np.zeros(2), np.zeros(3)
    x = np.zeros(n - 9)
    kalman.innovation(P, H, res, R, S, PH, out)
    kalman.correct(P, nav, x, res, S, PH, K, turn, np.zeros((2 * len(res), len(P))))
    return x, out, turn


@pytest.mark.parametrize("white", [1e-12, 1.0, 1e12])
def test_correction_keeps_the_covariance_positive(white):
    """Ill-conditioned on purpose: readings a million times better, and worse, than the state."""
    rng = np.random.default_rng(0)
    P, nav = spd(rng, 14), random_nav(rng)
    for _ in range(500):
        H = rng.normal(size=(3, 14))
        correction(P, H, white * np.eye(3), 1e-3 * rng.normal(size=3), nav)
        P += 1e-3 * np.eye(14)
    assert np.isfinite(P).all() and np.array_equal(P, P.T)
    # Joseph's form with the gain as rounded loses at most rounding against the noise added each time.
    assert np.linalg.eigvalsh(P).min() > 0.5e-3 * min(1.0, white / 1e-3)


def test_components_one_by_one_are_the_components_together():
    rng = np.random.default_rng(1)
    P0, H, R, res = spd(rng, 12), rng.normal(size=(3, 12)), np.diag([0.1, 0.2, 0.3]), 1e-6 * rng.normal(size=3)
    together, nav = P0.copy(), random_nav(rng)
    _, out, _ = correction(together, H.copy(), R, res.copy(), nav.copy())
    single, total, moved = P0.copy(), 0.0, np.zeros(12)
    for i in range(3):
        n = nav.copy()
        before = res[i : i + 1] - H[i] @ moved
        x, part, turn = correction(single, H[i : i + 1].copy(), R[i : i + 1, i : i + 1].copy(), before, n)
        total += part[0]
        moved += np.concatenate(
            [
                [(n[0] - nav[0]) * nav[15], (n[1] - nav[1]) * nav[16] * np.cos(nav[0]), nav[2] - n[2]],
                n[3:6] - nav[3:6],
                turn,
                x,
            ]
        )
    # residuals of 1e-6, so that the reset of the attitude (second order, 1e-6 relative) does not tell the two apart;
    # metres from radians round at 1e-9
    np.testing.assert_allclose(single, together, atol=1e-5)
    assert total == pytest.approx(out[0], rel=2e-3)


def test_power_is_exact_for_a_long_silence():
    phi, q = 0.999, 0.01
    W = np.zeros((4, 1, 1))
    kalman.power(np.array([[phi]]), np.array([[q]]), 100_000, W)
    assert W[0, 0, 0] == pytest.approx(phi**100_000, rel=1e-9, abs=1e-40)
    assert W[1, 0, 0] == pytest.approx(q * (1.0 - phi**200_000) / (1.0 - phi**2), rel=1e-10)
