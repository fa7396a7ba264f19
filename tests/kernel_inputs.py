"""Random input for kernels, and runs of a kernel beside its readable twin in `naive`."""

import naive
import numpy as np

from navfilter.kernels import measurement, strapdown
from navfilter.models.state import euler_from_matrix, matrix_from_euler

#: Radius [m] and squared eccentricity of WGS-84.
EARTH = (6378137.0, 6.69437999014e-3)
#: A transceiver: number of parameters -> where scale, misalignment and error of the ship's place begin.
HEARD = {0: (-1, -1, -1), 1: (0, -1, -1), 6: (-1, 0, 3), 7: (0, 1, 4)}
#: Two beacons: number of parameters -> where scale, offsets and places of the beacons begin.
RANGED = {0: (-1, -1, -1), 1: (0, -1, -1), 8: (-1, 0, 2), 9: (0, 1, 3)}


def assert_close(actual, expected, rtol=1e-11):
    for a, b in zip(actual, expected, strict=True):
        a, b = np.asarray(a), np.asarray(b)
        assert a.shape == b.shape
        finite = np.abs(b[np.isfinite(b)])
        np.testing.assert_allclose(a, b, rtol=0, atol=rtol * max(finite.max(initial=0.0), 1e-300))


def run_both(kernel, *args):
    """Run kernel and twin on copies of the arguments; returns both sets of arguments afterwards."""
    twin = getattr(naive, kernel.__name__)
    results = []
    for function in (kernel, twin):
        copies = [a.copy() if isinstance(a, np.ndarray) else a for a in args]
        value = function(*copies)
        results.append((value, copies))
    assert results[0][0] == results[1][0] or results[0][0] is None
    return results[0][1], results[1][1]


def spd(rng, n, scale=1.0):
    A = rng.normal(size=(n, n + 3))
    return scale * (A @ A.T) / n


def random_nav(rng):
    lat, h = rng.uniform(-1.2, 1.2), rng.uniform(-3000.0, 500.0)
    C = matrix_from_euler(*rng.uniform([-0.6, -0.6, -3.1], [0.6, 0.6, 3.1]))
    meridian, prime = naive.radii(lat)
    return np.concatenate(
        [[lat, rng.uniform(-3, 3), h], rng.normal(scale=3.0, size=3), C.ravel(), [meridian + h, prime + h]]
    )


def random_drive(rng, k, **settings):
    drv = np.zeros(strapdown.DRIVE_SIZE)
    drv[strapdown.PERIOD_S], drv[strapdown.HOLD_DENSITY] = 0.01, 0.1
    drv[strapdown.GAP_RATE_SD], drv[strapdown.GAP_FORCE_SD] = 0.05, 0.3
    drv[list(strapdown.PLACES)] = -1
    drv[strapdown.MOUNTING : strapdown.MOUNTING + 9] = matrix_from_euler(0.1, -0.2, 0.7).ravel()
    drv[strapdown.MAX_SPEED], drv[strapdown.ZERO_IS_VALID] = 20.0, 0.0
    for name, value in settings.items():
        at = getattr(strapdown, name)
        drv[at : at + np.size(value)] = value
    Phid, Qd, Cr = 0.5 * rng.normal(size=(k, k)) / max(k, 1), spd(rng, k, 1e-6), 0.1 * rng.normal(size=(6, k + 1))
    Cr[:, k] = rng.uniform(0.5, 2.0, 6) * 1e-4
    acc = np.vstack([np.eye(9 + k), np.zeros((3 * (9 + k), 9 + k))])
    return drv, 0.02 * rng.normal(size=k), Phid, Qd, Cr, acc


def uncalibrated_drive(rng, k, elements, wandering=(), **settings):
    """As `random_drive` of k states, with elements of M (3 * channel + axis) behind them, which are constants, but for
    those that are `wandering`.
    """
    count, whole = len(elements), k + len(elements)
    drv, xd, Phid, Qd, Cr, acc = random_drive(rng, whole, **settings)
    drv[strapdown.CALIBRATED] = count
    drv[strapdown.ELEMENTS : strapdown.ELEMENTS + count] = elements
    constant = np.arange(whole) >= k
    Phid[constant], Phid[:, constant], Cr[:, :whole][:, constant] = 0.0, 0.0, 0.0
    Phid[constant, constant] = 1.0
    Qd[constant], Qd[:, constant] = 0.0, 0.0
    for i in wandering:
        Phid[k + i, k + i], Qd[k + i, k + i] = 0.9, 1e-6
    return drv, xd, Phid, Qd, Cr, acc


def imu_samples(rng, n, increments=False):
    samples = np.column_stack(
        [np.full(n, 0.01), 0.3 * rng.normal(size=(n, 3)), rng.normal(loc=(0.0, 0.0, -9.8), size=(n, 3))]
    )
    samples[:, 0] += rng.uniform(-0.003, 0.003, n)
    if n > 3:
        samples[n // 2, 0] = 0.046  # a gap: five ticks, and what happened unseen
    samples[:, 1:] *= 0.01 if increments else 1.0
    return samples


FIELD = np.array([24.0, 7.0, 30.0, 25.0])
SHALLOW = np.array([44.0, -17.0, 10.0, 25.0])  # not nearly vertical, tilted by iron as it may be


def readings(rng, nav):
    """One reading per measurement kernel: kernel, reading, constants, numbers of parameters, axes."""
    mounted = np.concatenate([[0.5, -0.2, 0.3], matrix_from_euler(0.1, -0.2, 0.7).ravel()])
    place = np.array([nav[0] + 2e-6, nav[1] - 3e-6, nav[2] + 4.0])
    return [
        (measurement.body_velocity, rng.normal(size=3), mounted, (0, 4, 6), 3),
        (measurement.water_velocity, rng.normal(size=3), np.append(mounted, 2.0), (2, 6, 8), 3),
        (measurement.water_velocity, rng.normal(size=3), np.append(mounted, 6.0), (6, 10, 12), 3),
        (measurement.heading, np.array([2.5, 11.0]), np.array([0.1, 20.0]), (0, 6), 1),
        (measurement.heading, np.array([-2.5, np.nan]), np.array([0.1, 20.0]), (6,), 1),
        (measurement.magnetometer, FIELD, np.array([0.1, 20.0, -1.0, -1.0]), (0, 6), 1),
        (measurement.magnetometer, SHALLOW, np.array([0.1, 20.0, 0.0, -1.0]), (3,), 1),
        (measurement.magnetometer, SHALLOW, np.array([0.1, 20.0, -1.0, 0.0]), (5,), 1),
        (measurement.magnetometer, SHALLOW, np.array([0.1, 20.0, 6.0, 9.0]), (14,), 1),
        (measurement.depth, np.array([12.0]), np.array([0.5, -0.2, 0.3, 2.0]), (0, 1), 1),
        (measurement.position, place, np.array([0.5, -0.2, 0.3]), (0,), 3),
        (measurement.position, np.array([nav[0], nav[1] + 2 * np.pi, np.nan]), np.array([0.5, -0.2, 0.3]), (0,), 3),
        (measurement.earth_rate, 1e-4 * rng.normal(size=3), np.array([7.292115e-5]), (0,), 3),
        (measurement.velocity, rng.normal(size=3), np.zeros(1), (0,), 3),
        *_acoustics(mounted, nav, np.random.default_rng(rng.integers(1000))),
    ]


def _acoustics(mounted, nav, rng):
    """The same of beams, ranges and USBL."""
    directions = rng.normal(size=(4, 3))
    beams = np.concatenate([mounted, (directions / np.linalg.norm(directions, axis=1, keepdims=True)).ravel(), [0.0]])
    current = beams + 2.0 * (np.arange(25) == 24)
    tilted = euler_from_matrix(nav[6:15].reshape(3, 3) @ mounted[3:].reshape(3, 3))
    axes, point = naive.earth_axes(*nav[:3], *EARTH)
    around = np.concatenate([point + axes.T @ (2e4 * rng.normal(size=3)) for _ in range(2)])
    turn = matrix_from_euler(0.1, -0.3, 2.0)
    sight = turn @ (point - around[:3])
    bearing, elevation = np.arctan2(sight[1], sight[0]) + 0.1, np.arctan2(sight[2], np.hypot(*sight[:2])) - 0.05
    seen = np.concatenate([[1e4, bearing, elevation], around[:3], turn.ravel()])
    heard = {size: np.concatenate([EARTH, mounted[:3], at]) for size, at in HEARD.items()}
    ranged = {size: np.concatenate([EARTH, mounted[:3], at, around]) for size, at in RANGED.items()}
    return [
        (measurement.altitude, np.array([12.0]), np.append(mounted[:3], -2.0), (0, 1), 1),
        (measurement.ground_velocity, rng.normal(size=3), mounted[:3], (0,), 3),
        (measurement.attitude, tilted + 0.2, np.append(0.1, mounted[3:]), (0, 3), 3),
        (measurement.beam_velocity, rng.normal(size=8), beams, (0, 4, 6), 8),
        (measurement.beam_velocity, rng.normal(size=8), current, (2, 6, 8), 8),
        *((measurement.slant_range, np.array([400.0, 1.0]), cfg, (size,), 1) for size, cfg in ranged.items()),
        *((measurement.usbl, seen, cfg, (size,), 3) for size, cfg in heard.items()),
        (measurement.usbl, np.where(np.arange(15) == 2, np.nan, seen), heard[7], (7,), 3),
    ]


def drive_result(args):
    nav, xd, drv, _, _, _, _, acc = args
    m = acc.shape[1]
    return nav[:3], nav[3:6], nav[6:15], nav[15:], xd, drv, acc[:m], acc[m : 2 * m]
