"""How states follow a change of the error model: `transfer`, `state_change`, the register, and `LearnedArma` itself."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import solve_discrete_lyapunov
from scipy.signal import lfilter
from state_differences import differences

import navfilter as nf
from navfilter.filter.model_change import state_change, transfer
from navfilter.filter.records import Tape
from navfilter.filter.state_layout import Layout
from navfilter.models.error_models import block_level
from navfilter.models.learned_arma import (
    LearnedArma,
    known_walk,
    known_white,
    learned_part,
    register_block,
    register_labels,
    resolve_prior,
    with_learned,
)
from navfilter.navigation.track_assembly import forward_track, smoothed_track
from navfilter.timeseries.model import ArmaModel

PERIOD_S = 0.25


def random_model(rng, p, q, sd=1.0, **more):
    """Poles and zeros within radius 0.95, complex ones in pairs."""

    def coefficients(n):
        roots = []
        while len(roots) < n:
            if n - len(roots) > 1 and rng.random() < 0.6:
                z = rng.uniform(0.2, 0.95) * np.exp(1j * rng.uniform(0.1, 3.0))
                roots += [z, z.conjugate()]
            else:
                roots.append(rng.uniform(-0.95, 0.95))
        return np.poly(roots).real[1:] if n else []

    return ArmaModel(coefficients(p), coefficients(q), sd, **more)


def learnt(model, slow=None):
    return LearnedArma(model=model, slow=slow)


ORDERS = [(0, 0), (1, 0), (0, 1), (1, 1), (2, 1), (1, 3), (4, 2), (4, 4)]
PAIRS = [(a, b) for a in ORDERS for b in ORDERS]
SLOW, SMOOTH = nf.GaussMarkov(sd=0.5, tau_s=60.0), nf.GaussMarkov(sd=0.8, tau_s=300.0, order=2)
SLOWS = (None, SLOW, SMOOTH, SLOW + SMOOTH)


# ---------------------------------------------------------------- the register


@pytest.mark.parametrize("order", ORDERS)
def test_stationary_register_has_the_autocovariance_of_the_model(order):
    model = random_model(np.random.default_rng(sum(order)), *order, sd=0.7)
    block, lags = register_block(model), 12
    expected = model.autocovariance(lags)
    P, ours = block.P0, []
    for _ in range(lags + 1):
        ours.append(block.C @ P @ block.C + (block.r if not ours else 0.0))
        P = block.Phi @ P
    np.testing.assert_allclose(ours, expected[: lags + 1], rtol=0, atol=1e-10 * expected[0])
    if block.size:
        np.testing.assert_allclose(
            block.Phi @ block.P0 @ block.Phi.T + block.Q, block.P0, rtol=0, atol=1e-11 * block.P0.max()
        )


def test_register_reproduces_the_difference_equation_of_coefficients_that_jump():
    """Same innovations: the register, its coefficients replaced on the way, against lfilter piece by piece with the
    true past.
    """
    rng = np.random.default_rng(5)
    models = [random_model(rng, 4, 2), random_model(rng, 4, 2), random_model(rng, 4, 2)]
    e, k, q = rng.normal(size=90), 4, 2
    state, out = np.zeros(k + q), []
    for t in range(90):
        block = register_block(models[t // 30])
        g = np.zeros(k + q)
        g[0] = g[k] = 1.0
        assert np.array_equal(block.Q, np.outer(g, g) * models[0].sd ** 2)
        state = block.Phi @ state + g * e[t]
        out.append(block.C @ state)
    y = np.zeros(90)
    for t in range(90):
        a, c = models[t // 30].ar, models[t // 30].ma
        y[t] = (
            e[t]
            + sum(c[j] * e[t - 1 - j] for j in range(q) if t > j)
            - sum(a[i] * y[t - 1 - i] for i in range(k) if t > i)
        )
    np.testing.assert_allclose(out, y, rtol=0, atol=1e-12 * np.abs(y).max())
    np.testing.assert_allclose(
        out[:30], lfilter(np.r_[1, models[0].ma], np.r_[1, models[0].ar], e[:30]), rtol=0, atol=1e-12
    )


@pytest.mark.parametrize("slow", [None, SLOW, SMOOTH, SLOW + SMOOTH])
@pytest.mark.parametrize("order", ORDERS)
def test_the_block_is_the_fast_part_beside_the_slow_ones(order, slow):
    model = random_model(np.random.default_rng(9), *order, sd=0.7)
    learned, fast, lags = learnt(model, slow), register_block(model), 12
    block = learned.block(PERIOD_S)
    assert block.size == fast.size + sum(part.order for part in learned.slow_parts)
    expected = model.autocovariance(lags)[: lags + 1].copy()
    for part in learned.slow_parts:
        own = part.block(PERIOD_S)
        expected += [own.C @ np.linalg.matrix_power(own.Phi, k) @ own.P0 @ own.C for k in range(lags + 1)]
    P, ours = block.P0, []
    for k in range(lags + 1):
        ours.append(block.C @ P @ block.C + (block.r if k == 0 else 0.0))
        P = block.Phi @ P
    np.testing.assert_allclose(ours, expected, rtol=0, atol=1e-10 * expected[0])


# ---------------------------------------------------------------- another level


def scatter(block):
    """By what readings scatter from one to the next, as a variance."""
    return float(block.C @ block.Q @ block.C) + block.r


@pytest.mark.parametrize("slow", [SLOW, SMOOTH, SLOW + SMOOTH + nf.White(sd=0.4)])
@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("level", [1.0, 2.7, 64.0])
def test_a_level_is_that_of_what_readings_scatter_by(order, slow, level):
    """Each of the two parts has changed by as little as makes up that sum: by squares less than any other two."""
    model = random_model(np.random.default_rng(7), *order, sd=0.1)
    one, now = learnt(model, slow), LearnedArma(model=model, slow=slow, level=level)
    parts = [register_block(model), *(part.block(PERIOD_S) for part in one.beside)]
    is_slow = [False, *(isinstance(part, nf.GaussMarkov) for part in one.beside)]
    of_both = [sum(scatter(b) for b, of in zip(parts, is_slow, strict=True) if of == which) for which in (False, True)]
    quick, lasting = now.levels(PERIOD_S)
    assert [quick, lasting] @ np.array(of_both) == pytest.approx(level * sum(of_both), rel=1e-12)
    changes = np.array([quick, lasting]) - 1.0
    for step in (-0.01, 0.01):
        others = changes + step * np.array([of_both[1], -of_both[0]]) / sum(of_both)
        assert others @ others >= changes @ changes
    block = now.block(PERIOD_S)
    assert scatter(block) == pytest.approx(level * scatter(one.block(PERIOD_S)), rel=1e-12)
    sizes = [lasting if of else quick for of in is_slow]
    expected = sum(size * part.state_variance for size, part in zip(sizes, parts, strict=True))
    assert block.state_variance == pytest.approx(expected, rel=1e-12)
    assert now.s0(PERIOD_S) == pytest.approx(
        sum(size * block_level(part) for size, part in zip(sizes, parts, strict=True)), rel=1e-9
    )


def test_a_level_says_of_a_slow_part_what_readings_show_of_it():
    """Of one that is next to nothing beside white noise nothing, of one alone all."""
    hidden = LearnedArma(model=ArmaModel([], [], 1.0), slow=nf.GaussMarkov(sd=0.1, tau_s=600.0), level=9.0)
    alone = LearnedArma(model=ArmaModel([], [], 1e-6), slow=nf.GaussMarkov(sd=0.1, tau_s=600.0), level=9.0)
    assert hidden.levels(PERIOD_S) == pytest.approx((9.0, 1.0), abs=1e-3)
    assert alone.levels(PERIOD_S)[1] == pytest.approx(9.0, abs=1e-3)


def test_what_is_new_at_a_level_is_as_large_as_its_part():
    model = ArmaModel([-0.5], [], 1.0)
    now = LearnedArma(model=model, slow=SLOW, level=4.0)
    quick, lasting = now.levels(PERIOD_S)
    M, N = transfer(learnt(ArmaModel([], [], 1.0), SLOW), now, PERIOD_S)
    np.testing.assert_allclose(N, np.diag([quick * register_block(model).P0[0, 0], 0.0]), rtol=1e-12)
    np.testing.assert_array_equal(M, [[0.0], [1.0]])
    M, N = transfer(learnt(model), now, PERIOD_S)
    np.testing.assert_allclose(N, np.diag([0.0, lasting * SLOW.sd**2]), rtol=1e-12)
    np.testing.assert_array_equal(M, [[1.0], [0.0]])


# ---------------------------------------------------------------- transfer of one axis


def joint(old, new):
    """Stationary covariance of the new register, and which elements it shares with the old one: what the change is to
    condition on.
    """
    labels, have = register_labels(new), register_labels(old)
    return register_block(new).P0, [i for i, label in enumerate(labels) if label in have]


def test_equal_models_keep_their_states_exactly():
    rng = np.random.default_rng(0)
    for order in ORDERS:
        model = learnt(random_model(rng, *order))
        for error in (
            model,
            LearnedArma(model=model.model, slow=SLOW + SMOOTH),
            nf.RandomWalk(density=1.0) + model,
            nf.White(sd=0.1) + nf.GaussMarkov(sd=1.0, tau_s=3.0, order=2),
        ):
            M, N = transfer(error, error, PERIOD_S)
            np.testing.assert_array_equal(M, np.eye(len(M)))
            np.testing.assert_array_equal(N, np.zeros_like(M))


@pytest.mark.parametrize("order", ORDERS)
def test_the_same_order_keeps_its_states_whatever_the_coefficients(order):
    rng = np.random.default_rng(1)
    M, N = transfer(learnt(random_model(rng, *order)), learnt(random_model(rng, *order, sd=5.0)), PERIOD_S)
    np.testing.assert_array_equal(M, np.eye(len(M)))
    np.testing.assert_array_equal(N, np.zeros_like(M))


@pytest.mark.parametrize(("before", "after"), PAIRS)
def test_what_both_registers_hold_stays_and_the_rest_is_drawn_given_it(before, after):
    """M and N are the conditional mean and covariance of the new model's stationary register, by a dense conditioning
    of its joint.
    """
    rng = np.random.default_rng(10 * sum(before) + sum(after))
    old, new = random_model(rng, *before), random_model(rng, *after, sd=17.0)
    M, N = transfer(learnt(old), learnt(new), PERIOD_S)
    P, shared = joint(old, new)
    have = register_labels(old)
    assert M.shape == (len(P), len(have))
    picked = np.eye(len(have))[[have.index(register_labels(new)[i]) for i in shared]].reshape(len(shared), len(have))
    if shared:
        G = np.linalg.solve(P[np.ix_(shared, shared)], P[shared]).T
        scale = np.sqrt(np.diag(P))
        np.testing.assert_allclose(M, G @ picked, rtol=0, atol=1e-8 * scale.max())
        np.testing.assert_allclose(
            N / np.outer(scale, scale), (P - G @ P[shared]) / np.outer(scale, scale), rtol=0, atol=1e-8
        )
        np.testing.assert_allclose(M[shared], picked, rtol=0, atol=1e-9)
        np.testing.assert_allclose(N[shared], 0.0, rtol=0, atol=1e-9 * P.max())
    else:
        np.testing.assert_array_equal(N, P)
        np.testing.assert_array_equal(M, 0.0)


@pytest.mark.parametrize(("before", "after"), [(a, b) for a, b in PAIRS if sum(a) and sum(b)])
def test_the_present_error_neither_jumps_nor_loses_its_variance(before, after):
    rng = np.random.default_rng(sum(before) - sum(after) + 40)
    old, new = learnt(random_model(rng, *before)), learnt(random_model(rng, *after))
    (M, N), C_old, C_new = transfer(old, new, PERIOD_S), old.block(PERIOD_S).C, new.block(PERIOD_S).C
    np.testing.assert_allclose(C_new @ M, C_old, rtol=0, atol=1e-9)
    assert abs(C_new @ N @ C_new) < 1e-9 * new.block(PERIOD_S).P0[0, 0]


@pytest.mark.parametrize(("before", "after"), [((2, 1), (2, 1)), ((1, 0), (3, 2)), ((0, 0), (1, 1)), ((2, 0), (0, 0))])
def test_slow_parts_of_the_same_orders_keep_their_states(before, after):
    """Whatever their sizes and times; the registers follow as without them."""
    rng = np.random.default_rng(17)
    old, new = random_model(rng, *before), random_model(rng, *after)
    other = nf.GaussMarkov(sd=2.0, tau_s=20.0) + nf.GaussMarkov(sd=0.1, tau_s=900.0, order=2)
    M, N = transfer(learnt(old, SLOW + SMOOTH), learnt(new, other), PERIOD_S)
    fast, noise = transfer(learnt(old), learnt(new), PERIOD_S)
    r, c = fast.shape
    np.testing.assert_array_equal(M[:r, :c], fast)
    np.testing.assert_array_equal(N[:r, :r], noise)
    np.testing.assert_array_equal(M[r:, c:], np.eye(3))
    assert not M[:r, c:].any() and not M[r:, :c].any() and not N[r:].any() and not N[:, r:].any()


@pytest.mark.parametrize(("before", "after"), [(a, b) for a in SLOWS for b in SLOWS if a is not b and b is not None])
def test_slow_parts_of_other_orders_share_the_sum_of_the_old_ones(before, after):
    """Given their sum they are as their stationary distribution has it, by a dense conditioning; the fast part is left
    alone.
    """
    model = random_model(np.random.default_rng(18), 2, 1)
    M, N = transfer(learnt(model, before), learnt(model, after), PERIOD_S)
    r = register_block(model).size
    np.testing.assert_array_equal(M[:r, :r], np.eye(r))
    assert not M[:r, r:].any() and not M[r:, :r].any() and not N[:r].any() and not N[:, :r].any()
    new, old = learnt(model, after).block(PERIOD_S), learnt(model, before).block(PERIOD_S)
    P, C = new.P0[r:, r:], new.C[r:]
    if not (P.size and old.size > r):
        np.testing.assert_allclose(N[r:, r:], P, rtol=1e-12)
        assert not M[r:].any()
        return
    G = P @ C / (C @ P @ C)
    np.testing.assert_allclose(M[r:, r:], np.outer(G, old.C[r:]), rtol=1e-12)
    np.testing.assert_allclose(N[r:, r:], P - np.outer(G, C @ P), rtol=0, atol=1e-12)
    np.testing.assert_allclose(new.C @ M, old.C, rtol=0, atol=1e-12)
    assert abs(new.C @ N @ new.C) < 1e-12


@pytest.mark.parametrize(
    ("before", "after"),
    [
        ((0.01, SLOW), (5.0, nf.GaussMarkov(sd=0.01, tau_s=30.0))),  # what was slow is in the register now
        ((5.0, SLOW), (0.01, SLOW + SMOOTH)),  # what was in the register is slow
        ((1.0, SLOW + SMOOTH), (1.0, None)),
    ],
)
def test_where_parts_cannot_hold_what_they_did_the_present_error_alone_stays(before, after):
    """A register of what is a hundredth of the error says nothing of the past of all of it: by a dense conditioning."""
    rng = np.random.default_rng(19)
    old, new = (learnt(random_model(rng, 2, 1, sd=sd), slow) for sd, slow in (before, after))
    (M, N), one, two = transfer(old, new, PERIOD_S), old.block(PERIOD_S), new.block(PERIOD_S)
    G = two.P0 @ two.C / (two.C @ two.P0 @ two.C)
    np.testing.assert_allclose(M, np.outer(G, one.C), rtol=1e-12)
    np.testing.assert_allclose(N, two.P0 - np.outer(G, two.C @ two.P0), rtol=0, atol=1e-9 * two.P0.max())


@pytest.mark.parametrize("white", [0.0, 0.3])
@pytest.mark.parametrize("slow", [None, SLOW, SLOW + SMOOTH])
@pytest.mark.parametrize("order", [(0, 0), (1, 0), (2, 1), (4, 4)])
def test_a_prior_hands_over_its_present_error(order, slow, white):
    """A fixed model's output becomes the present value of what is learnt, shared by the variances of its parts; the
    white part of it is not known.
    """
    coloured = nf.GaussMarkov(sd=1.3, tau_s=2.0, order=2)
    prior = coloured + nf.White(sd=white)
    model = random_model(np.random.default_rng(3), *order)
    old, new = LearnedArma(prior=prior), LearnedArma(prior=prior, model=model, slow=slow)
    M, N = transfer(old, new, PERIOD_S)
    before, after = old.block(PERIOD_S), new.block(PERIOD_S)
    if not after.size:
        assert M.shape == (0, 2) and N.shape == (0, 0)
        return
    np.testing.assert_allclose(after.C @ M, before.C, rtol=0, atol=1e-12)
    assert pytest.approx(white**2, abs=1e-12) == after.C @ N @ after.C
    P = after.P0
    g = P @ after.C / (after.C @ P @ after.C)
    expected = P - np.outer(g, P @ after.C) + white**2 * np.outer(g, g)
    np.testing.assert_allclose(N, expected, rtol=0, atol=1e-9 * P.max())


def test_noise_of_a_change_is_positive_semidefinite():
    rng = np.random.default_rng(7)
    for _ in range(200):
        (p, q), (r, s) = rng.integers(0, 6, size=2), rng.integers(0, 6, size=2)
        old, new = random_model(rng, p, q, sd=rng.uniform(0.1, 10)), random_model(rng, r, s, sd=rng.uniform(0.1, 10))
        N = transfer(learnt(old), learnt(new), PERIOD_S)[1]
        np.testing.assert_array_equal(N, N.T)
        if len(N):
            values = np.linalg.eigvalsh(N)
            assert values.min() >= -1e-12 * max(np.abs(values).max(), 1e-300)


def test_parts_beside_the_learnt_one_keep_their_states():
    walk, markov = nf.RandomWalk(density=0.1), nf.GaussMarkov(sd=1.0, tau_s=2.0)
    rng = np.random.default_rng(2)
    old, new = random_model(rng, 2, 1), random_model(rng, 3, 1)
    M, N = transfer(walk + learnt(old) + markov, walk + learnt(new) + markov, PERIOD_S)
    inner, noise = transfer(learnt(old), learnt(new), PERIOD_S)
    assert M.shape == (1 + 4 + 1, 1 + 3 + 1)
    np.testing.assert_array_equal(M[1:5, 1:4], inner)
    np.testing.assert_array_equal(N[1:5, 1:5], noise)
    assert M[0, 0] == M[5, 4] == 1.0
    assert np.count_nonzero(M[0]) == np.count_nonzero(M[5]) == 1 and not N[0].any() and not N[5].any()


def test_a_part_that_is_new_starts_like_at_the_start():
    walk = nf.RandomWalk(density=0.1, start_sd=0.7)
    M, N = transfer(nf.White(sd=1.0), nf.White(sd=1.0) + walk, PERIOD_S)
    assert M.shape == (1, 0)
    np.testing.assert_allclose(N, [[0.49]], rtol=1e-12)


# ---------------------------------------------------------------- all states of a vehicle


def vehicle_with(compass, dvl):
    return nf.Vehicle(
        imu=nf.Imu(rate_hz=100.0),
        sensors={
            "dvl": nf.BodyVelocity(rate_hz=4.0, error=dvl, scale_sd=0.01, misalignment_sd_rad=0.01),
            "compass": nf.Heading(rate_hz=8.0, error=compass, bias_sd_rad=0.02),
        },
    )


def test_state_change_leaves_everything_else_alone():
    rng = np.random.default_rng(4)
    models = [random_model(rng, p, q) for p, q in ((2, 1), (1, 0), (0, 0), (3, 2))]
    old = vehicle_with(nf.GaussMarkov(sd=0.01, tau_s=30.0), (learnt(models[0]), learnt(models[1]), learnt(models[2])))
    new = vehicle_with(nf.GaussMarkov(sd=0.01, tau_s=30.0), (learnt(models[3]), learnt(models[1]), learnt(models[0])))
    before, after = Layout.of(old), Layout.of(new)
    M, N = state_change(before, old, after, new)
    assert M.shape == (after.size, before.size) and N.shape == (after.size, after.size)
    changed = {name for name in after.names if name.startswith(("dvl_x[", "dvl_z["))}
    for i, name in enumerate(("",) * 9 + after.names):
        if name in changed:
            continue
        j = i if i < 9 else 9 + before.names.index(name)
        assert M[i, j] == 1.0 and np.count_nonzero(M[i]) == 1, name
        assert not N[i].any() and not N[:, i].any()
    x = slice(after.groups["dvl"].start, after.groups["dvl"].start + 5)
    np.testing.assert_array_equal(N[x, x], transfer(learnt(models[0]), learnt(models[3]), 0.25)[1])


def test_the_predicted_reading_does_not_jump():
    """Adopting other coefficients in the middle of a run leaves the state as it is, and the estimated errors of equal
    order too.
    """
    rng = np.random.default_rng(6)
    nav = nf.Navigator(
        vehicle_with(learnt(random_model(rng, 2, 1, sd=0.01)), nf.White(sd=0.05)),
        nf.Start(latitude_deg=45.0, longitude_deg=0),
    )
    for k in range(1, 401):
        nav.step(0.01 * k, [0.0, 0.0, 0.0], [0.0, 0.0, -9.8])
        if k % 25 == 0:
            nav.correct("compass", 0.01 * k, 0.02 * rng.normal())
    position, errors = nav.state, nav.errors
    nav.adopt("compass", learnt(random_model(rng, 2, 1, sd=0.03)))
    assert nav.errors == errors
    nav.adopt("compass", learnt(random_model(rng, 4, 2, sd=0.03)))
    assert nav.errors["compass[0]"] == pytest.approx(errors["compass[0]"], rel=1e-9)
    np.testing.assert_array_equal(nav.state.minus(position), np.zeros(9))
    np.testing.assert_allclose(nav.state.covariance, position.covariance, rtol=1e-12, atol=1e-20)
    assert nav.counts["adopted"] == 2
    with pytest.raises(ValueError, match="sonar"):
        nav.adopt("sonar", nf.White(sd=1.0))
    with pytest.raises(ValueError, match="needs one error model"):
        nav.adopt("compass", "white")


# ---------------------------------------------------------------- LearnedArma as a value


@pytest.mark.parametrize(
    ("wrong", "says"),
    [
        ({"orders": ()}, "orders"),
        ({"orders": ((1, -1),)}, "orders"),
        ({"orders": ((11, 0),)}, "orders"),
        ({"window": 99}, "window"),
        ({"hop": 0}, "hop"),
        ({"prior": "white"}, "prior"),
        ({"prior": LearnedArma()}, "prior"),
        ({"prior": nf.White(sd=1.0) + LearnedArma()}, "prior"),
        ({"model": ArmaModel([-1.0], [], 1.0)}, "stable.*1.0000"),
        ({"model": ArmaModel([-2.0, 1.1], [], 1.0)}, "stable"),
        ({"model": ArmaModel([], [], 1.0), "slow": nf.Arma(ar=(-0.5,), sd=1.0)}, "Gauss-Markov"),
        ({"model": ArmaModel([], [], 1.0), "slow": SLOW + nf.RandomWalk(density=1.0)}, "Gauss-Markov"),
        ({"slow": SLOW}, "slow.*model"),
        ({"slow": nf.White(sd=1.0)}, "slow.*model"),
        ({"model": ArmaModel([], [], 1.0), "level": 0.0}, "level"),
    ],
)
def test_impossible_descriptions_are_refused(wrong, says):
    with pytest.raises(ValueError, match=says):
        LearnedArma(**wrong)


def test_orders_are_sorted_and_each_counts_once():
    assert LearnedArma(orders=[(2, 1), (1, 0), (2, 1), (0, 0), (1, 1)]).orders == ((0, 0), (1, 0), (1, 1), (2, 1))


def test_block_is_that_of_the_model_else_of_the_prior():
    prior = nf.GaussMarkov(sd=1.0, tau_s=3.0)
    model = ArmaModel([-0.5, 0.2], [0.3], 0.4)
    assert LearnedArma(prior=prior).block(PERIOD_S).size == 1
    assert LearnedArma(prior=prior, model=model).block(PERIOD_S).size == 3
    with pytest.raises(ValueError, match="prior"):
        LearnedArma().block(PERIOD_S)
    assert LearnedArma(prior=prior, model=model, slow=SLOW + SMOOTH).block(PERIOD_S).size == 6
    assert str(LearnedArma(prior=prior, model=model)) == "LearnedArma(2, 1)"
    assert "GaussMarkov(sd=0.5" in str(LearnedArma(prior=prior, model=model, slow=SLOW))
    assert "GaussMarkov" in str(LearnedArma(prior=prior))


def test_the_learnt_part_of_a_sum():
    learned, white = LearnedArma(), nf.White(sd=0.1)
    assert learned_part(white) is None and learned_part(learned) is learned and learned_part(white + learned) is learned
    with pytest.raises(ValueError, match="one LearnedArma"):
        learned_part(learned + LearnedArma(window=500))
    other = LearnedArma(window=777)
    assert with_learned(learned, other) is other
    assert with_learned(white + learned + white, other) == white + other + white
    assert with_learned(white, other) is white


def test_a_prior_is_filled_in_only_where_there_is_neither_prior_nor_model():
    prior, own, white = nf.GaussMarkov(sd=1.0, tau_s=3.0), nf.White(sd=2.0), nf.White(sd=0.1)
    adopted = LearnedArma(model=ArmaModel([], [], 1.0))
    given = (white, LearnedArma(), LearnedArma(prior=own), adopted, white + LearnedArma(window=500))
    expected = (
        white,
        LearnedArma(prior=prior),
        LearnedArma(prior=own),
        adopted,
        white + LearnedArma(prior=prior, window=500),
    )
    assert resolve_prior(given, prior) == expected
    sensor = nf.Heading(rate_hz=8.0, error=LearnedArma())
    assert learned_part(sensor.models[0]).prior == nf.Heading.prior
    imu = nf.Imu(rate_hz=100.0, gyro=LearnedArma())
    assert all(learned_part(model).prior is not None for model in imu.models[:3])


def test_what_is_known_beside_the_learnt_part():
    learned, white, walk = (
        LearnedArma(),
        nf.White(sd=0.1) + nf.White(density=0.2),
        nf.RandomWalk(density=3.0) + nf.RandomWalk(density=4.0),
    )
    assert known_white(white + learned, 0.25) == pytest.approx(0.01 + 0.16)
    assert known_white(white, 0.25) == 0.0  # a belief about the sensor, not knowledge
    assert known_walk(walk + learned) == pytest.approx(5.0)
    assert known_walk(learned) == 0.0


# ---------------------------------------------------------------- the track


@pytest.mark.parametrize("smooth", [False, True])
def test_states_that_appear_and_vanish_are_nan_on_the_track(smooth):
    """state_names is the union over time, each sensor's states together; a state that does not exist is NaN, never a
    stale number.
    """
    vehicle = nf.Vehicle(
        imu=nf.Imu(rate_hz=20.0),
        sensors={
            "compass": nf.Heading(rate_hz=4.0, error=nf.White(sd=0.02), bias_sd_rad=0.01),
            "depth": nf.Depth(rate_hz=2.0, error=nf.GaussMarkov(sd=0.1, tau_s=5.0)),
        },
    )
    tape = Tape(None, smoothable=smooth)
    nav = nf.Navigator(vehicle, nf.Start(latitude_deg=45.0, longitude_deg=0.0), tape)
    two, four = learnt(ArmaModel([-0.5], [0.2], 0.02)), learnt(ArmaModel([-0.5, 0.1], [0.2, 0.1], 0.02))
    changes = {5.0: two, 10.0: four, 15.0: nf.White(sd=0.02)}
    for k in range(1, 401):
        time_s = k / 20.0
        nav.step(time_s, [0.0, 0.0, 0.0], [0.0, 0.0, -9.8])
        if k % 5 == 0:
            nav.correct("compass", time_s, 0.01)
        if k % 10 == 0:
            nav.correct("depth", time_s, 0.05)
        if time_s in changes:
            nav.adopt("compass", changes[time_s])
    track = forward_track(nav, "t", 0.0)
    if smooth:
        track = smoothed_track(track, nav, 0.0, False)
    assert len(set(track.state_names)) == len(track.state_names) == len(track.state_units)
    compass = [name for name in track.state_names if name.startswith("compass")]
    assert set(compass) == {f"compass[{i}]" for i in range(4)} | {"compass.bias", *(c for c in compass if "." in c)}
    places = [track.state_names.index(name) for name in compass]
    assert places == list(
        range(places[0], places[0] + len(places))
    )  # side by side, though they came later than those of the depth
    t = track.time_s
    for name, begin, end in (
        ("compass[0]", 5, 15),
        ("compass[1]", 5, 15),
        ("compass[2]", 10, 15),
        ("compass[3]", 10, 15),
    ):
        value, sd = track.state(name)
        exists = np.isfinite(value)
        np.testing.assert_array_equal(exists, np.isfinite(sd))
        np.testing.assert_array_equal(exists, (t >= begin) & (t < end))
    for name in ("compass.bias", "depth[0]"):
        assert np.isfinite(track.state(name)[0]).all() and np.isfinite(track.state(name)[1]).all()
    assert track.error_models["compass"] == [(0.0, nf.White(sd=0.02)), *changes.items()]
    assert np.isfinite(track.latitude).all() and np.isfinite(track.covariance).all()


def test_registers_are_stationary():
    rng = np.random.default_rng(11)
    for _ in range(100):
        p, q = rng.integers(0, 5, size=2)
        block = register_block(random_model(rng, p, q))
        if block.size:
            assert np.abs(np.linalg.eigvals(block.Phi)).max() < 1.0
            P = solve_discrete_lyapunov(block.Phi, block.Q)
            np.testing.assert_allclose(block.P0, P, rtol=0, atol=1e-9 * P.max())


def test_laid_out_from_the_layout_before_as_from_nothing():
    """What an adoption does not touch keeps its group; only its place changes."""
    error = nf.GaussMarkov(sd=0.1, tau_s=10.0) + nf.White(sd=0.1)
    same = nf.Depth(rate_hz=1, error=error, offset_sd_m=0.2)
    sensors = {"compass": nf.Heading(rate_hz=8, error=nf.White(sd=0.1)), "one": same, "two": same}
    old = nf.Vehicle(imu=nf.Imu(rate_hz=100), sensors=sensors)
    new = old.with_error(compass=error)
    before = Layout.of(old)
    after = Layout.of(new, (old, before))
    assert differences(after, Layout.of(new)) == [] and after.groups["one"].start == before.groups["one"].start + 1
    assert (
        after.groups["one"].names != after.groups["two"].names and after.groups["two"].Phi is before.groups["two"].Phi
    )
    whole = nf.Vehicle(imu=nf.Imu(rate_hz=100), sensors={name: replace(s) for name, s in new.sensors.items()})
    for ours, other in zip(state_change(before, old, after, new), state_change(before, old, after, whole), strict=True):
        np.testing.assert_array_equal(ours, other)
