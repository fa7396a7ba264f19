"""Every public kernel against its readable twin in `naive`, on random input; and what a kernel file may import.

Twins round in another order (matrix products, matrix exponential, inverse instead of cofactors): `assert_close` allows
rounding relative to the largest element of each array, far below what any mistake would do.
"""

import ast
import math
import re
from pathlib import Path

import naive
import numpy as np
import pytest
from kernel_inputs import (
    assert_close,
    drive_result,
    imu_samples,
    random_drive,
    random_nav,
    readings,
    run_both,
    spd,
    uncalibrated_drive,
)

from navfilter.kernels import consistency, kalman, measurement, strapdown, symmetric
from navfilter.kernels.compiling import decorators

FOLDER = Path(strapdown.__file__).parent
#: What goes from reading to reading: a recording taken one by one is held against the same in batches, and live.
LOOPS = {"gravity_is_due", "propagate_sample", "correct_reading", "run_batch"}
FILES = sorted(path.stem for path in FOLDER.glob("*.py") if path.stem != "__init__")


def public_kernels(name):
    """Names of the public njit functions that a kernel file defines (by their decorator, so that it works without the
    JIT too).
    """
    found = [
        node for node in ast.walk(ast.parse((FOLDER / f"{name}.py").read_text())) if isinstance(node, ast.FunctionDef)
    ]
    compiled = [f.name for f in found if any("njit" in ast.unparse(d) for d in f.decorator_list)]
    return [kernel for kernel in compiled if not kernel.startswith("_")]


@pytest.mark.parametrize("name", FILES)
def test_every_public_kernel_has_a_twin(name):
    found = public_kernels(name)
    assert found, f"{name}.py holds no kernel"
    assert [kernel for kernel in found if kernel not in LOOPS and not callable(getattr(naive, kernel, None))] == []


@pytest.mark.parametrize("name", FILES)
def test_kernel_files_import_only_math_numpy_numba(name):
    # the checksum of what a kernel calls looks at the kernels' own files alone
    allowed = {"math", "numpy", "numba", "operator", "navfilter.kernels", "navfilter.kernels.compiling"}
    allowed |= {f"navfilter.kernels.compiling.{tool}" for tool in ("decorators", "registers", "vectors", "addresses")}
    imported = set()
    for node in ast.walk(ast.parse((FOLDER / f"{name}.py").read_text())):
        if isinstance(node, ast.Import):
            imported |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            imported.add(node.module)
    assert {"numba" if module.startswith("numba.") else module for module in imported} <= allowed


def test_a_kept_kernel_counts_only_as_long_as_what_it_calls_is_the_same(tmp_path, monkeypatch):
    """`batch` calls `kalman`, that calls `symmetric`; numba itself looks at the file of a kernel alone, or its time."""
    stamp, source = decorators.checksum.__wrapped__, decorators._source
    for cached in (stamp, source):
        assert cached("navfilter.kernels.batch")
    before = {name: stamp(f"navfilter.kernels.{name}") for name in FILES}
    monkeypatch.setattr(
        decorators, "_source", lambda module: source(module) + "\n" * module.endswith("kernels.symmetric")
    )
    changed = {name for name in FILES if stamp(f"navfilter.kernels.{name}") != before[name]}
    assert {"batch", "kalman", "consistency", "symmetric"} <= changed and not {"strapdown", "arma_fit"} & changed


def _symmetric(rng, n):
    M = rng.normal(size=(n, n))
    return M + M.T


@pytest.mark.parametrize("n", [11, 16, 23])
def test_kernels_of_symmetric_matrices(n):
    rng = np.random.default_rng(n)
    T, M = rng.normal(size=(9, n)), _symmetric(rng, n)
    for args in [
        (symmetric.copy, T[0], np.zeros(n)),
        (symmetric.mirror_columns, T, M, 9, 9),
        (symmetric.symmetrise, T[:, :9].copy(), 6, 9),
        (consistency.reset_heading, M, 0.02),
        (consistency.add_turned, M, 3, 6, 0.1, -0.2, 0.3),
        (consistency.reset_tilts, M, 0.01, -0.02),
        (consistency.turn_back, M, rng.normal(size=n), (0.3, -0.2), 9),
    ]:
        ours, twins = run_both(*args)
        assert_close(ours, twins, 1e-14)
    for first, last in [(3, 6), (6, 8), (6, 9), (9, n)]:
        args = M.copy(), first, min(last, first + 4)
        args[0][first : args[2]] += 1.0
        ours, twins = run_both(symmetric.mirror_rows, *args)
        np.testing.assert_array_equal(ours[0], twins[0])


def test_what_turns_with_the_heading():
    rng = np.random.default_rng(0)
    gain = rng.normal(size=15)
    np.testing.assert_allclose(
        consistency.deviation_change(gain, 0.3, 9), naive.deviation_change(gain, 0.3, 9), rtol=1e-15
    )
    gains, res = rng.normal(size=(15, 3)), rng.normal(size=3)
    np.testing.assert_allclose(
        consistency.current_change(gains, res, 9), naive.current_change(gains, res, 9), rtol=1e-14
    )


@pytest.mark.parametrize("size", [0.0, 1e-3, 0.03, 0.032, 1.0, 3.0])
def test_a_vector_is_turned_by_small_angles_and_large_ones(size):
    by, v = size * np.array([0.6, -0.64, 0.48]), (0.3, -2.0, 1.0)
    factors = strapdown.rodrigues(by @ by)
    np.testing.assert_allclose(factors, naive.rodrigues(by @ by), rtol=1e-12)
    turned = strapdown.rotated(*factors, *by, *v)
    np.testing.assert_allclose(turned, naive.rotated(*factors, *by, *v), rtol=1e-14, atol=1e-15)
    np.testing.assert_allclose(turned, naive.rotation(by) @ v, rtol=1e-12)


def functions(name):
    tree = ast.parse((FOLDER / f"{name}.py").read_text())
    return [node for node in tree.body if isinstance(node, ast.FunctionDef)]


def pairs(assignment):
    """Each target of an assignment with its value."""
    target, value = assignment.targets[0], assignment.value
    if isinstance(target, ast.Tuple) and isinstance(value, ast.Tuple):
        return list(zip(target.elts, value.elts, strict=True))
    return [(target, value) for target in assignment.targets]


@pytest.mark.parametrize("name", FILES)
def test_no_array_is_assigned_to_a_slice(name):
    # numba compiles the text of the error for shapes that differ: four seconds once, half a second for each kernel
    found = [
        f"{name}.{function.name}, line {node.lineno}"
        for function in functions(name)
        for node in ast.walk(function)
        if isinstance(node, ast.Assign)
        for target, value in pairs(node)
        if isinstance(target, ast.Subscript)
        and any(isinstance(part, ast.Slice) for part in ast.walk(target.slice))
        and not isinstance(value, ast.Constant)
    ]
    assert found == [], "copy it element by element"


@pytest.mark.parametrize("name", FILES)
def test_no_literal_is_passed_to_a_kernel(name):
    # for each literal numba compiles the callee, and all that it calls, another time
    decorators = {f.name: " ".join(ast.unparse(d) for d in f.decorator_list) for f in functions(name)}
    own = {name for name, by in decorators.items() if "njit" in by and "inline=" not in by}
    found = [
        f"{name}.{function.name}, line {node.lineno}"
        for function in functions(name)
        for node in ast.walk(function)
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in own
        for value in node.args
        if isinstance(value, ast.Constant) and isinstance(value.value, int)
    ]
    assert found == [], "write int(0) for 0, or make two kernels of a flag"


@pytest.mark.parametrize("name", FILES)
def test_kernels_are_cached_and_without_fastmath(name):
    text = (FOLDER / f"{name}.py").read_text()
    assert "fastmath=True" not in text and '"fastmath": True' not in text
    shared = re.search(r"^OPTIONS\b.*[\"{(]cache\W+True", text, re.M)
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.FunctionDef):
            decorators = " ".join(ast.unparse(d) for d in node.decorator_list)
            if "njit" not in decorators:
                continue  # builds instructions for kernels
            inlined = "inline='always'" in decorators  # compiled, and cached, within its callers
            assert "cache=True" in decorators or inlined or (shared and "**OPTIONS" in decorators), (
                f"{name}.{node.name}: {decorators}"
            )


@pytest.mark.parametrize("elements", [(), (0, 4, 8), (1, 2, 3, 5, 6, 7), tuple(range(18))], ids=len)
@pytest.mark.parametrize("k", [0, 6])
@pytest.mark.parametrize("increments", [False, True])
def test_imu_kernels(k, increments, elements):
    rng = np.random.default_rng(k)
    _same_as_the_twins(rng, *uncalibrated_drive(rng, k, elements, INCREMENTS=float(increments)), increments)


@pytest.mark.parametrize("plain", [False, True])
@pytest.mark.parametrize("wandering", [(2,), (0, 1, 2, 3)], ids=len)
def test_imu_kernels_with_elements_that_wander(wandering, plain):
    rng = np.random.default_rng(0)
    drv, xd, Phid, Qd, Cr, acc = uncalibrated_drive(rng, 6, (0, 4, 8, 13), wandering)
    if plain:  # one state of an error model a reading, as it is
        Phid[:6, :6], Qd[:6, :6], Cr[:, :6] = np.diag(rng.uniform(0.5, 1.0, 6)), np.diag(rng.uniform(size=6)), np.eye(6)
    _same_as_the_twins(rng, drv, xd, Phid, Qd, Cr, acc, False)


def test_elements_count_where_a_sample_comes_before_the_end_of_a_hold():
    """Its step goes back, and takes off what the hold was too long by; of no length it does nothing."""
    rng = np.random.default_rng(2)
    drv, xd, Phid, Qd, Cr, acc = uncalibrated_drive(rng, 6, (0, 4, 8, 13))
    nav, sample = random_nav(rng), imu_samples(rng, 1, False)
    for held_s in (2.0 * sample[0, 0], sample[0, 0]):
        drv[strapdown.HELD_S] = held_s
        drv[strapdown.CONSUMED : strapdown.CONSUMED + 6] = sample[0, 1:] * held_s
        ours, twins = run_both(strapdown.imu_steps, nav, xd, drv, sample, Phid, Qd, Cr, acc)
        assert_close(drive_result(ours), drive_result(twins))
        assert np.all(np.isfinite(ours[7]))


def _same_as_the_twins(rng, drv, xd, Phid, Qd, Cr, acc, increments):
    nav, n = random_nav(rng), 12
    for block in range(3):
        args = nav, xd, drv, imu_samples(rng, n, increments), Phid, Qd, Cr, acc
        ours, twins = run_both(strapdown.imu_steps, *args)
        assert_close(drive_result(ours), drive_result(twins))
        nav, xd, drv, acc = ours[0], ours[1], ours[2], ours[7]
        ours, twins = run_both(strapdown.imu_hold, nav, xd, drv, 0.004 * (block + 1), Phid, Qd, Cr, acc)
        assert_close(drive_result(ours), drive_result(twins))
        nav, xd, drv, acc = ours[0], ours[1], ours[2], ours[7]


DEAD_RECKONING = {
    "plain": {},
    "arm": {"LEVER": (0.8, -0.3, 0.4), "DECLINATION": -0.2},
    "parameters": {"LEVER": (0.8, -0.3, 0.4), "DEVIATION": 4, "SCALE": 8},
    "scale": {"SCALE": 4},
    "scales": {"SCALE": 4, "SCALE_STEP": 1.0, "ATTITUDE_CLOCK": 10, "VELOCITY_CLOCK": 11},
    "clocks": {"LEVER": (0.8, -0.3, 0.4), "SCALE": 4, "ATTITUDE_CLOCK": 8, "VELOCITY_CLOCK": 9},
    "current": {"LEVER": (0.8, -0.3, 0.4), "SCALE": 4, "CURRENT": 8},
    "velocity's clock": {"VELOCITY_CLOCK": 4},
    "uncertain arm": {"LEVER": (0.8, -0.3, 0.4), "ARM": 5, "ATTITUDE_CLOCK": 8},
}


@pytest.mark.parametrize("settings", DEAD_RECKONING.values(), ids=DEAD_RECKONING.keys())
def test_dead_reckoning_kernels(settings):
    rng = np.random.default_rng(3)
    k = (
        12
        if {"DEVIATION", "SCALE_STEP"} & set(settings)
        else 10
        if {"ATTITUDE_CLOCK", "CURRENT"} & set(settings)
        else 8
    )
    drv, xd, Phid, Qd, Cr, acc = random_drive(rng, k, PERIOD_S=0.25, **settings)
    Cr[:, 4:k] = 0.0  # parameters act through the readings, not through C
    nav = random_nav(rng)
    for block in range(4):
        samples = np.column_stack([np.full(8, 0.25), 0.4 * rng.normal(size=(8, 3)), rng.normal(size=(8, 3))])
        samples[2, 4:] = np.nan
        samples[3, 4:] = 0.0  # lost
        samples[4, 5] = -32.768  # a sentinel
        samples[6, 0] = 2.2  # a gap
        samples[7, 0] = 0.4
        samples[1, 2] = samples[2, 3] = np.nan  # no attitude; neither
        if block == 0:
            samples[0, 4:] = np.nan  # nothing to go by but the start's velocity
        if block == 1:
            samples[6:, 1:4] = np.nan
        if block == 2:
            samples[:, 0], samples[:, 1:] = 2.0, samples[0, 1:]  # stuck
            samples[6:, 4] += 0.1
        if block == 3:
            samples[:, 0], samples[:, 3] = 2.0, samples[0, 3]  # the heading alone
            drv[strapdown.SEEN], drv[strapdown.REPEATS] = 150.0, 0.01
        ours, twins = run_both(strapdown.dead_reckoning_steps, nav, xd, drv, samples, Phid, Qd, Cr, acc)
        assert_close(drive_result(ours), drive_result(twins))
        nav, xd, drv, acc = ours[0], ours[1], ours[2], ours[7]
        ours, twins = run_both(strapdown.dead_reckoning_hold, nav, xd, drv, 0.1, Phid, Qd, Cr, acc)
        assert_close(drive_result(ours), drive_result(twins))
        nav, xd, drv, acc = ours[0], ours[1], ours[2], ours[7]


@pytest.mark.parametrize(
    ("steps", "elements", "wandering"),
    [
        (strapdown.imu_steps, (), ()),
        (strapdown.imu_steps, (0, 4, 8, 13), ()),
        (strapdown.imu_steps, range(18), ()),
        (strapdown.imu_steps, (0, 4, 8, 13), (2,)),
        (strapdown.dead_reckoning_steps, (), ()),
    ],
    ids=["imu", "constants", "all constants", "a constant that wanders", "reckoning"],
)
def test_a_trace_is_what_each_sample_leaves(steps, elements, wandering):
    """To the last bit what the samples leave one by one; and that of the twin."""
    rng, k = np.random.default_rng(4), 6 + len(elements)
    drv, xd, Phid, Qd, Cr, acc = uncalibrated_drive(rng, 6, elements, wandering, PERIOD_S=0.25)
    nav, samples, m = random_nav(rng), imu_samples(rng, 5), 9 + k
    trace = np.full((5, 8 + m + 2 * m * m + strapdown.WIDE), np.nan)
    kernel = {strapdown.imu_steps: strapdown.imu_traced}.get(steps, strapdown.dead_reckoning_traced)
    args = nav, xd, drv, samples, Phid, Qd, Cr, acc
    ours, twins = run_both(kernel, *args, trace)
    assert_close(drive_result(ours[:8]), drive_result(twins[:8]))
    left = slice(0, -strapdown.WIDE)
    for one, other in zip(ours[8], twins[8], strict=True):
        assert_close([one[left]], [other[left]])
    single = [a.copy() for a in args]
    for n in range(len(samples)):
        steps(*single[:3], samples[n : n + 1].copy(), *single[4:])
        np.testing.assert_array_equal(ours[8][n][left], np.concatenate([*single[:2], single[7][: 2 * m].ravel()]))
    plain = [a.copy() for a in args]
    kernel(*plain, trace[:0])
    for at in (0, 1, 2):
        np.testing.assert_array_equal(plain[at], ours[at])


def test_radii_and_gravity():
    for lat in np.linspace(-1.5, 1.5, 7):
        np.testing.assert_allclose(strapdown.radii(lat), naive.radii(lat), rtol=1e-14)
        for h in (-6000.0, 0.0, 3000.0):
            np.testing.assert_allclose(strapdown.gravity(lat, h), naive.gravity(lat, h), rtol=1e-14)


def test_stamps_to_steps():
    samples = np.column_stack([np.array([1.0, 1.01, 1.5, 1.51]), np.ones((4, 6))])
    limits = np.full(6, 2.0)
    ours, twins = run_both(strapdown.stamps_to_steps, samples, 0.98, limits, 0.03, 5.0)
    assert_close(ours[:1], twins[:1])
    np.testing.assert_allclose(ours[0][:, 0], [0.02, 0.01, 0.49, 0.01], rtol=1e-12)
    bad = [
        (2, 0, 1.01),
        (0, 0, 0.98),
        (3, 0, math.inf),
        (3, 0, 7.0),
        (1, 0, math.nan),
        (2, 3, math.nan),
        (2, 6, -math.inf),
        (2, 5, -2.1),
    ]
    for row, column, value in bad:
        spoilt = samples.copy()
        spoilt[row, column] = value
        ours, twins = run_both(strapdown.stamps_to_steps, spoilt, 0.98, limits, 0.03, 5.0)
        assert naive.stamps_to_steps(spoilt.copy(), 0.98, limits, 0.03, 5.0) == -1
        np.testing.assert_array_equal(ours[0], spoilt)


@pytest.mark.parametrize("seed", range(3))
def test_measurement_kernels(seed):
    rng = np.random.default_rng(seed)
    nav = random_nav(rng)
    for kernel, z, cfg, sizes, axes in readings(rng, nav):
        for size in sizes:
            par = 0.1 * rng.normal(size=size)
            rate = rng.normal(size=3)
            args = z, nav, rate, par, cfg, np.full((axes, 9 + size), 7.0), np.full(axes, 7.0)
            ours, twins = run_both(kernel, *args)
            # so does a distance in the Earth's axes, over kilometres
            assert_close(
                [ours[5]], [twins[5]], rtol=1e-12 if kernel in (measurement.slant_range, measurement.usbl) else 1e-13
            )
            # A difference of latitudes times the Earth's radius rounds to 1e-9 m.
            np.testing.assert_allclose(ours[6], twins[6], rtol=0, atol=1e-8)


@pytest.mark.parametrize(("hard", "soft"), [(0, 3), (6, -1), (-1, 6), (6, 9)])
@pytest.mark.parametrize("dip", [-1.0, 1.0])
def test_what_the_iron_leaves_out(hard, soft, dip):
    """Only the states of the iron and of the tilt count; where the field points down, and where up."""
    rng, k = np.random.default_rng(4), (6 if 0 not in (hard, soft) else 0) + 3 * (hard >= 0) + 5 * (soft >= 0)
    nav, cfg = random_nav(rng), np.array([0.1, 20.0, hard, soft, 30.0, 70.0])
    z = np.append(nav[6:15].reshape(3, 3).T @ [20.0, 3.0, 45.0 * dip], math.nan)
    near, res, P = np.zeros((1, 9 + k)), np.zeros(1), spd(rng, 12 + k, 1e-3)
    measurement.magnetometer(z, nav, np.zeros(3), np.zeros(k), cfg, near, res)
    ours, twins = run_both(consistency.iron_second_order, z, near, P, 12, cfg, np.eye(1))
    assert_close([ours[5]], [twins[5]], 1e-9)
    assert ours[5][0, 0] > 1.0


def test_what_a_tilt_leaves_out_equals_its_twin_and_is_a_variance():
    """Of a tilt drawn with its covariance: what that along the azimuth, and the turn itself, change of the slope."""
    rng = np.random.default_rng(6)
    nav, cfg, near, res = random_nav(rng), np.array([0.1, 20.0, -1.0, -1.0, 1.0, 1.0]), np.zeros((1, 9)), np.zeros(1)
    P, z = spd(rng, 9, 1e-4), np.append(nav[6:15].reshape(3, 3).T @ [5.0, 0.5, -60.0], math.nan)
    measurement.magnetometer(z, nav, np.zeros(3), np.zeros(0), cfg, near, res)
    ours, twins = run_both(consistency.tilt_second_order, z, near, P, 9, cfg, np.zeros((1, 1)))
    assert_close([ours[5]], [twins[5]], 1e-12)
    tilt = rng.multivariate_normal(np.zeros(2), P[6:8, 6:8], size=400_000)
    north, dip = np.array([math.cos(0.1), math.sin(0.1)]), 60.0 / math.hypot(5.0, 0.5)
    across, along = dip * tilt @ north, dip * tilt @ [-north[1], north[0]]
    # a mean of sixth powers of 400,000 scatters by 1.5 %
    assert ours[5][0, 0] == pytest.approx(np.mean((across * along + 0.5 * across**3) ** 2), rel=0.06)


def test_what_bends_of_a_deviation_equals_its_twin_and_is_a_variance():
    """Of heading and deviation drawn with their covariance: the variance of what the linear equation leaves out."""
    rng = np.random.default_rng(5)
    nav, cfg, near, res = random_nav(rng), np.array([0.1, 20.0, -1.0, -1.0, 1.0]), np.zeros((1, 15)), np.zeros(1)
    P, z = spd(rng, 18, 1e-3), np.array([1.0, math.nan])
    measurement.heading(z, nav, np.zeros(3), np.zeros(6), cfg, near, res)
    ours, twins = run_both(consistency.deviation_second_order, z, near, P, 12, cfg, np.zeros((1, 1)))
    assert_close([ours[5]], [twins[5]], 1e-12)
    drawn = rng.multivariate_normal(np.zeros(5), P[np.ix_([8, 13, 14, 15, 16], [8, 13, 14, 15, 16])], size=200_000)
    sin, cos, sin2, cos2 = near[0, 10:14]
    left = drawn[:, 0] * (drawn[:, 1:] @ [cos, -sin, 2.0 * cos2, -2.0 * sin2])
    # 200,000 squares of products scatter by 1.3 %
    assert ours[5][0, 0] == pytest.approx(np.var(left), rel=0.05)


def test_a_vertical_field_has_no_azimuth():
    nav = random_nav(np.random.default_rng(0))
    res, field = np.zeros(1), nav[6:15].reshape(3, 3).T @ np.array([0.0, 0.0, 50.0])
    measurement.magnetometer(
        np.array([*field, np.nan]),
        nav,
        np.zeros(3),
        np.zeros(0),
        np.array([0.0, 0.0, -1.0, -1.0]),
        np.zeros((1, 9)),
        res,
    )
    # Rounding leaves 1e-15 of 50 in the horizontal: the azimuth is either undefined or arbitrary, never an exception.
    assert math.isnan(res[0]) or abs(res[0]) <= math.pi


@pytest.mark.parametrize("kind", ["dense", "blocks", "constants", "none", "moving average"])
def test_fold(kind):
    rng = np.random.default_rng(1)
    n, m = 17, 9 if kind == "none" else 12
    nav, acc = random_nav(rng), np.zeros((4 * m, m))
    nav[6:15] += 1e-7 * rng.normal(size=9)  # no longer quite orthonormal
    acc[:m], acc[m : 2 * m] = np.eye(m) + 0.1 * rng.normal(size=(m, m)), spd(rng, m)
    if kind != "dense":
        acc[9:m, :9], acc[11:m] = 0.0, np.eye(m)[11:]
    if kind == "constants":
        acc[9:m] = np.diag([1.0] * 9 + [0.5, 1.0, 1.0][: m - 9])[9:]
    if kind == "moving average":
        acc[11] = 0.0  # of its last state noise is all there is
    P = spd(rng, n)
    present, twin = run_both(kalman.present, P, acc, nav, False, 0.0, np.zeros(9 * (n + m + 9)), np.zeros(72 + n))
    assert_close(present[6:], twin[6:], 1e-14)
    ours, twins = run_both(kalman.fold, P, acc, nav, np.zeros((m, n)))
    np.testing.assert_array_equal(present[6], [*ours[0][:9, :9].ravel(), *ours[0].diagonal()[9:]])
    assert_close([ours[0], ours[1][: 2 * m], ours[2]], [twins[0], twins[1][: 2 * m], twins[2]], 1e-14)
    np.testing.assert_array_equal(ours[0], ours[0].T)
    C = ours[2][6:15].reshape(3, 3)
    np.testing.assert_allclose(C.T @ C, np.eye(3), atol=1e-12)


@pytest.mark.parametrize(("change_m_s", "share"), [(1e3, 1.0), (2.0, 0.8), (0.01, 0.0)])
def test_the_heading_is_discounted_by_what_the_change_of_velocity_may_err(change_m_s, share):
    """Of its square of 4 some 0.8 are the variance; a fold of the discounted transition is what is `present`."""
    rng = np.random.default_rng(3)
    n, m = 15, 12
    nav, P = random_nav(rng), spd(rng, n, 0.01)
    P[8] *= 30.0  # the heading's own errors do not count
    P[:, 8] *= 30.0
    acc = np.vstack([np.eye(m) + 0.1 * rng.normal(size=(m, m)), spd(rng, m, 0.001), np.zeros((2 * m, m))])
    J = acc[3:5] - np.eye(2, m, 3)
    J[:, 8] = 0.0
    k = 0.8 / np.trace(J @ P[:m, :m] @ J.T + acc[m + 3 : m + 5, 3:5])
    acc[3:5], acc[m : 2 * m] = np.eye(2, m, 3) + math.sqrt(k) * J, k * acc[m : 2 * m]
    acc[3, 8], acc[4, 8], acc[2, 5] = change_m_s * 0.6, change_m_s * -0.8, 0.5
    before = acc.copy()
    present, twin = run_both(kalman.present, P, acc, nav, True, 0.0, np.zeros(9 * (n + m + 9)), np.zeros(72 + n))
    assert_close(present[6:], twin[6:], 1e-14)
    np.testing.assert_array_equal(present[1], before)
    ours, twins = run_both(consistency.attitude_second_order, P, acc, nav, 0.0, np.zeros(2 * m))
    assert_close(ours[:2], twins[:2], 1e-14)
    assert ours[1][3, 8] / before[3, 8] == pytest.approx(share, abs=1e-5)
    changed = {(i, 8) for i in (0, 1, 3, 4)} | {(m + 5, 5)}
    assert set(map(tuple, np.argwhere(ours[1] != before).tolist())) == changed
    folded, _ = run_both(kalman.fold, P, ours[1], nav, np.zeros((m, n)))
    np.testing.assert_array_equal(present[6], [*folded[0][:9, :9].ravel(), *folded[0].diagonal()[9:]])


@pytest.mark.parametrize("rows", [11, 22])
def test_what_has_not_moved_is_not_folded_and_nothing_changes(rows):
    rng = np.random.default_rng(12)
    m, acc = 11, np.vstack([np.eye(11), np.zeros((33, 11))])
    assert kalman.is_identity(acc[:rows]) and naive.is_identity(acc[:rows])
    for i, j in [(0, 3), (5, 5), (4, 2), (rows - 1, m - 1)]:
        A = acc[:rows].copy()
        A[i, j] += 1e-9
        assert not kalman.is_identity(A) and not naive.is_identity(A)
    P, nav = spd(rng, 18), random_nav(rng)
    folded, _ = run_both(kalman.fold, P, acc, nav, np.zeros((m, 18)))
    dims = np.array([1, 18, m, 0, m, 0, 0, 0])
    none, mem = np.zeros((2, 0, 0)), np.zeros(kalman.memory_offsets(dims)[-1])
    predicted, _ = run_both(kalman.predict, P, nav, rng.normal(size=9), acc, none, mem, dims, 0)
    np.testing.assert_array_equal(predicted[0], folded[0])
    np.testing.assert_array_equal(predicted[1], folded[2])


@pytest.mark.parametrize("count", [0, 1, 2, 3, 7, 40])
def test_power(count):
    rng = np.random.default_rng(2)
    Phi, Q = rng.normal(size=(4, 4)) / 2, spd(rng, 4)
    ours, twins = run_both(kalman.power, Phi, Q, count, np.zeros((4, 4, 4)))
    assert_close(ours[3][:2], twins[3][:2], 1e-12)


def test_tick():
    rng = np.random.default_rng(3)
    ours, twins = run_both(
        kalman.advance_block,
        spd(rng, 16),
        rng.normal(size=7),
        11,
        rng.normal(size=(3, 3)),
        spd(rng, 3),
        np.zeros((3, 16)),
    )
    assert_close(ours[:2], twins[:2], 1e-14)
    np.testing.assert_array_equal(ours[0], ours[0].T)


@pytest.mark.parametrize("missing", [(), (0,), (1, 2), (0, 1, 2)])
@pytest.mark.parametrize("white", [0.3, 0.0])
def test_innovation_and_correct(missing, white):
    rng = np.random.default_rng(4)
    n, nav, res = 15, random_nav(rng), 0.1 * rng.normal(size=3)
    res[list(missing)] = np.nan
    args = (
        0.1 * spd(rng, n),
        rng.normal(size=(3, n)),
        res,
        white * spd(rng, 3),
        np.zeros((6, 3)),
        np.zeros((3, n)),
        np.zeros(2),
    )
    ours, twins = run_both(kalman.innovation, *args)
    assert_close(ours[1:], twins[1:], 1e-11)
    P, _, res, _, S, PH, _ = twins
    args = P, nav, rng.normal(size=n - 9), res, S, PH, np.zeros((n, 3)), np.zeros(3), np.zeros((6, n))
    ours, twins = run_both(kalman.correct, *args)
    assert_close(
        [ours[0], ours[1][:6], ours[1][6:15], *ours[2:8]], [twins[0], twins[1][:6], twins[1][6:15], *twins[2:8]], 1e-11
    )
    np.testing.assert_array_equal(ours[0], ours[0].T)
    assert np.linalg.eigvalsh(ours[0]).min() > -1e-14


@pytest.mark.parametrize("a", [2, 4, 8])
@pytest.mark.parametrize("missing", [(), (1,), (0, 1)])
def test_innovation_of_other_numbers_of_axes(a, missing):
    """Beams come in fours and eights, a speed over ground in two."""
    rng = np.random.default_rng(8)
    n, res = 15, 0.1 * rng.normal(size=a)
    res[list(missing)] = np.nan
    work = np.zeros((2 * a, a)), np.zeros((a, n)), np.zeros(2)
    ours, twins = run_both(kalman.innovation, 0.1 * spd(rng, n), rng.normal(size=(a, n)), res, spd(rng, a, 0.3), *work)
    assert_close(ours[1:], twins[1:], 1e-11)


@pytest.mark.parametrize(("wrong", "verdict"), [((), 4), ((2,), 3), ((1, 2), 0), ((0, 3), 0)])
@pytest.mark.parametrize("missing", [(), (3,)])
def test_one_component_that_contradicts_the_others_is_left_out(wrong, missing, verdict):
    """As long as more than half remain: of three readings of a plane one, of two none."""
    rng = np.random.default_rng(9)
    dims = np.array([4, 12, 9, 0, 9, 1, 2, 0])
    at, a, n = kalman.memory_offsets(dims), 4, 12
    P, mem, C = 1e-4 * spd(rng, n), np.zeros(at[-1]), np.full((a, 1), 0.1)
    mem[at[7] : at[8]] = rng.normal(size=at[8] - at[7])
    res = 0.03 * rng.normal(size=a)
    res[list(wrong)] += 5.0 * np.array([1.0, -1.0])[: len(wrong)]
    res[list(missing)] = np.nan
    mem[at[3] : at[4]] = res
    limits = np.array([0.5, 15.1, 18.4, 21.1, 23.5])
    args = P, random_nav(rng), np.zeros(n - 9), C, 1e-3 * np.eye(a), mem, dims, limits
    ours, twins = run_both(kalman.update, *args)
    seen = set(range(4)) - set(missing)
    left = seen & set(wrong)
    expected = 0 if verdict == 0 and len(left) > 1 else len(seen) - len(left)
    out = ours[5][at[8] : at[9]]
    assert out[2] == float(expected > 0) and (not expected or out[1] == expected)
    if expected:
        assert set(np.flatnonzero(np.isnan(out[3 + a :]))) == left | set(missing)
    parts = (0, 2, 3) if expected else (0, 3)
    for part in parts:
        assert_close([ours[5][at[part] : at[part + 1]]], [twins[5][at[part] : at[part + 1]]], 1e-10)
    assert_close([ours[0], np.nan_to_num(out)], [twins[0], np.nan_to_num(twins[5][at[8] : at[9]])], 1e-10)


def test_innovation_of_a_scalar():
    rng = np.random.default_rng(5)
    for res, P in (
        (np.array([0.3]), spd(rng, 10)),
        (np.array([np.nan]), spd(rng, 10)),
        (np.array([0.3]), np.zeros((10, 10))),
    ):
        args = P, rng.normal(size=(1, 10)), res, np.zeros((1, 1)), np.zeros((2, 1)), np.zeros((1, 10)), np.zeros(2)
        ours, twins = run_both(kalman.innovation, *args)
        assert_close(ours[1:], twins[1:], 1e-13)
        assert np.isfinite(ours[6]).all()


@pytest.mark.parametrize(("count", "verdict"), [(0, 1.0), (1, 1.0), (4, 0.0)])
def test_predict_and_update_work_through_the_channels_memory(count, verdict):
    rng = np.random.default_rng(6)
    dims = np.array([3, 18, 11, 5, 12, 4, 1, 0])  # three axes, four error states and one parameter
    a, n, m, b, _, errors, par, _ = dims
    at = kalman.memory_offsets(dims)
    assert tuple(at) == naive.memory_offsets(dims)
    P, nav, x, mem = spd(rng, n), random_nav(rng), rng.normal(size=n - 9), np.zeros(at[-1])
    acc = np.vstack([np.eye(m) + 0.1 * rng.normal(size=(m, m)), spd(rng, m), np.zeros((2 * m, m))])
    model = np.array([0.5 * rng.normal(size=(b, b)), spd(rng, b)])
    ours, twins = run_both(kalman.predict, P, nav, x, acc, model, mem, dims, count)
    assert_close(
        [ours[0], ours[1], ours[2], ours[5][: at[0]]], [twins[0], twins[1], twins[2], twins[5][: at[0]]], 1e-13
    )
    P, nav, x, _, _, mem, _, _ = twins
    mem[at[7] : at[8]] = rng.normal(size=a * (9 + par))
    mem[at[3] : at[4]] = 0.1, np.nan, -0.2
    limits = np.array([np.inf, 5.0, 1e9 if verdict else 1e-9, 9.0])
    ours, twins = run_both(kalman.update, P, nav, x, rng.normal(size=(a, errors)), spd(rng, a, 0.01), mem, dims, limits)
    assert ours[5][at[8] + 2] == verdict
    upto = at[5] if verdict else at[1]  # gain and the rest of the record are formed only by a correction
    parts = zip(np.split(ours[5], at[:-1])[:-1], np.split(twins[5], at[:-1])[:-1], strict=True)  # all but the work area
    for ours_part, twins_part in parts:
        if verdict:
            assert_close([ours_part], [twins_part], 1e-11)
    assert_close(
        [ours[0], ours[1][:6], ours[1][6:15], ours[2], ours[5][:upto]],
        [twins[0], twins[1][:6], twins[1][6:15], twins[2], twins[5][:upto]],
        1e-11,
    )


@pytest.mark.parametrize(
    ("a", "b", "deviation"),
    [(0, 0, 0), (0, 4, 0), (1, 0, 0), (1, 0, 12), (1, 4, 11), (3, 4, 0), (3, 0, -11), (4, 0, 0), (8, 4, 0)],
)
def test_smoother_kernels(a, b, deviation):
    rng = np.random.default_rng(7)
    n, m, start = 16, 11, 12
    parts = [np.eye(m) + 0.1 * rng.normal(size=(m, m)), rng.normal(size=(b, b))]
    if a:
        parts += [
            rng.normal(size=(a, n)),
            0.1 * rng.normal(size=(n, a)),
            spd(rng, a),
            rng.normal(size=a),
            0.3 * rng.normal(size=6),
        ]
    record = np.concatenate([part.ravel() for part in parts])
    ours, twins = run_both(
        kalman.smooth_record, spd(rng, n), rng.normal(size=n), record, a, m, b, start, deviation, np.zeros((3 * n, n))
    )
    assert_close(ours[:2], twins[:2], 1e-13)
    np.testing.assert_allclose(ours[0], ours[0].T, rtol=0, atol=1e-13 * np.abs(ours[0]).max())
    P, L, lam = 0.1 * spd(rng, n), ours[0], ours[1]
    ours, twins = run_both(kalman.smooth_row, P, L, lam, np.zeros(n), np.zeros((n, n)), np.zeros((n, n)))
    assert_close(ours[3:5], twins[3:5], 1e-13)
    np.testing.assert_array_equal(ours[4], ours[4].T)


@pytest.mark.parametrize(("holds", "until"), [((0, 1, 1, 4), 0), ((2, 4), 1), ((), 2), ((4,), 4)])
def test_smoother_goes_through_a_run_of_records_and_rows(holds, until):
    rng = np.random.default_rng(17)
    n, m, q = 14, 10, len(holds)
    kinds = [(0, m, 0, 0, 0), (1, m, 2, 11, 10), (3, 0, 0, 0, -11), (2, m, 3, 10, 0)]
    parts = [
        np.concatenate(
            [
                (np.eye(head) + 0.1 * rng.normal(size=(head, head))).ravel(),
                rng.normal(size=b * b),
                *([0.1 * rng.normal(size=2 * a * n), spd(rng, a).ravel(), rng.normal(size=a + 6)] if a else []),
            ]
        )
        for a, head, b, _, _ in kinds
    ]
    begins = 5 + np.cumsum([0, *map(len, parts)])[:-1]  # something else stands before them
    rows = [np.concatenate([rng.normal(size=8 + n), 0.1 * spd(rng, n)[np.tril_indices(n)]]) for _ in holds]
    firsts = 3 + np.cumsum([0, *map(len, rows)])[:-1][:q].astype(np.int64)
    flat = np.concatenate([np.zeros(5), *parts]), np.concatenate([np.zeros(3), *rows])
    work = np.zeros((3 * n, n)), np.zeros((2 * n, n))
    args = flat[0], begins, np.array(kinds), flat[1], firsts, np.array(holds, dtype=np.int64), 4, until
    for first, axes in ((3, 6), (0, 3)):
        found = np.zeros((q, n)), np.zeros((q, n, n)), first, np.zeros((q, 2, axes))
        ours, twins = run_both(kalman.smooth_run, spd(rng, n), rng.normal(size=n), *args, *found, *work)
        assert_close([*ours[:2], *ours[10:14]], [*twins[:2], *twins[10:14]], 1e-12)


@pytest.mark.parametrize("name", FILES)
def test_kernels_that_do_not_count_references_return_no_arrays(name):
    # what they returned would be counted down by a caller that counts, without having been counted up
    for node in ast.walk(ast.parse((FOLDER / f"{name}.py").read_text())):
        if isinstance(node, ast.FunctionDef) and any("UNCOUNTED" in ast.unparse(d) for d in node.decorator_list):
            returned = [part for part in ast.walk(node) if isinstance(part, ast.Return) and part.value is not None]
            slices = [part for given in returned for part in ast.walk(given) if isinstance(part, ast.Slice)]
            assert slices == [] or node.name == "_workspace", node.name


@pytest.mark.parametrize("seed", range(20))
def test_samples_of_dead_reckoning_are_taken_up_to_the_first_odd_one(seed):
    rng = np.random.default_rng(seed)
    drv = np.zeros(strapdown.DRIVE_SIZE)
    drv[strapdown.ZERO_IS_VALID] = seed % 2
    drv[strapdown.ODD_VELOCITY] = seed == 3
    samples = np.column_stack([np.full(30, 0.5), rng.normal(scale=0.01, size=(30, 6))])
    samples[:, 3] += rng.choice([0.0, 2.0 * np.pi, 0.3], p=[0.8, 0.15, 0.05], size=30)
    samples[:, 4] += rng.choice([0.0, 3.0], p=[0.97, 0.03], size=30)
    samples[rng.integers(30), 4:] = (0.0, np.nan)[seed % 3 == 0]
    assert strapdown.until_odd(drv, samples) == naive.until_odd(drv, samples)
    assert strapdown.has_jumped(drv) == naive.has_jumped(drv)
    drv[strapdown.JUMPED + seed % 4] = 1.0
    assert strapdown.has_jumped(drv) and naive.has_jumped(drv)
