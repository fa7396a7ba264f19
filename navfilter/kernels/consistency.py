"""What keeps an extended Kalman filter from being surer than it can be: its linear equations are those of an estimate.

Three things make it too sure. A slope that is not constant is made from the estimate, whose error it then shares; what
a linear equation leaves out is no noise that it knows of; and after a correction the error that is left stands in
another frame than the one that it was computed in. Each kernel says which of them it heeds, and where it is from. The
smoother goes through the last group backward.

P: covariance of all errors; near: Jacobian of a reading by the nine errors of navigation and the parameters of its
sensor, that stand in P from `first` on; K, res: gain and residuals of a reading.
"""

import math

import numpy as np

from navfilter.kernels import strapdown, symmetric
from navfilter.kernels.compiling.decorators import UNCOUNTED, flat, njit, scratch, shaped
from navfilter.kernels.compiling.registers import LANES, all_of, eight, if_below, put, times
from navfilter.kernels.compiling.vectors import WIDE, weighted

#: By so many standard deviations of the velocity its slopes may be off, see `consistency.limit_velocity_slopes`.
HELD = 3.0
#: A component that is not read counts beyond so many, see `consistency.limit_unread_slopes`. One would do for errors
#: that change from reading to reading, but a tilt's lasts: a tactical unit with forward speed, fixes and a heading
#: known to 5 deg had a heading NEES of 150 by that, of 2.3 by this, of 1450 with the slope as it is [1].
UNREAD = 3.0
#: And so much of the difference they follow all the same at each reading: over 50 readings their noise is a mean.
#: By 0.005 and by 0.05 a mounting beside a micromechanical unit had a NEES of 3 and 1.8, by this 1.4 [1].
FOLLOWED = 0.02
#: Mean square of half a cube, in cubes of the variance [1]: by so much the cosine of an azimuth changes its slope.
CUBE = 15.0 / 4.0
#: Power of half of g times a tilt squared, by the mean square of that: a tilt lasts for Schuler's time, the root of
#: R / g, at most [m^2/s^3].
TILT_SQUARED = 0.25 * strapdown.GRAVITY_EQUATOR**2 * math.sqrt(strapdown.EARTH_RADIUS / strapdown.GRAVITY_EQUATOR)
#: That of a place by its clock: fixes of centimetres had a NEES of 2.4 by this, of 4.6 by 0.02, of 2.3 by 0 [1].
STEADY = 0.002
#: Rates and forces are means over this time: what vibrates faster is no motion [s].
WINDOW_S = 0.2
#: A slope counts as far as it stands out of so many standard deviations of its noise: noise is in the velocity of the
#: state, too, and by k of them it draws a clock by SLOPE_S / (2 k^2), 5 ms, and a scale by 1 / k^2 at most [1].
TOLD = 10.0
#: A lever arm is told from so many on, see `consistency.consider_lever_arm`: by 10 of them, an arm of 0.5 m was drawn
#: by 1.2 of its standard deviations in half an hour beside a micromechanical unit, by 15 it is 0.7, by 20 nothing of a
#: swell is left [1].
TOLD_ARM = 15.0


# Second-order terms: what a linear equation leaves out (Gelb, 1974, sec. 6.1; Jazwinski, 1970, sec. 9.3).


@njit(cache=True, **UNCOUNTED)
def arc_term(P, head):
    """Second-order term of the position by the heading, for as much as the way has grown: on another heading it is an
    arc. It lies across the first-order one, along the way; half the way times the square of the heading's error, whose
    mean square is 3/4 of the first-order covariance squared (Jazwinski, 1970, sec. 9.3: second-order filter).
    """
    before = P[0, 8] * P[0, 8] + P[1, 8] * P[1, 8]
    north, east = head[0, 8], head[1, 8]
    after = north * north + east * east
    if after > before:
        share = 0.75 * (after - before) / after
        head[0, 0] += share * east * east
        head[1, 1] += share * north * north
        head[0, 1] -= share * north * east
        head[1, 0] -= share * north * east


@njit(cache=True)
def _of_square(bend):
    """Variance of half of what is quadratic in a normal error, mean included; bend (3, 3): its curvature times the
    covariance.
    """
    trace, square = 0.0, 0.0
    for i in range(3):
        trace += bend[i, i]
        for j in range(3):
            square += bend[i, j] * bend[j, i]
    return 0.5 * square + 0.25 * trace * trace


@njit(cache=True)
def _sagitta(near, distance, P):
    """Variance of what a distance grows by when its ends move across it, mean included [m^2].

    near: its slope along the line of sight, in the first row; P (3, 3): covariance of where the ends stand against each
    other [m^2].
    """
    length = math.sqrt(near[0, 0] ** 2 + near[0, 1] ** 2 + near[0, 2] ** 2)
    by, bend = 1.0 / max(length, 1e-12), np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            s = 0.0
            for r in range(3):
                s += ((1.0 if i == r else 0.0) - near[0, i] * by * near[0, r] * by) * P[r, j]
            bend[i, j] = s / max(distance, 1e-3)
    return _of_square(bend)


@njit(cache=True)
def range_second_order(z, near, P, first, cfg, R):
    """What the linear equation of `slant_range` leaves out, added to R (1, 1): the distance grows when its ends move
    across the line of sight too (Gelb, 1974, sec. 6.1).

    It is the same until the line of sight has turned: as white noise it gets the power of so many readings, the last of
    cfg. near: its Jacobian; P: covariance of all states, those of the sensor's parameters from `first` on.
    """
    apart, place = np.empty((3, 3)), int(cfg[7])
    at = first + place + 3 * int(z[1])
    for i in range(3):
        for j in range(3):
            apart[i, j] = P[i, j]
            if place >= 0:
                apart[i, j] += P[at + i, at + j] - P[i, at + j] - P[at + i, j]
    R[0, 0] += max(1.0, cfg[cfg.size - 1] * z[0]) * _sagitta(near, z[0], apart)


@njit(cache=True)
def usbl_second_order(z, near, P, first, cfg, R):
    """What the linear equation of `usbl` leaves out, added to R (3, 3): of a distance, and of a direction, which turns
    faster the nearer the vehicle may be. Arguments as for `range_second_order`.
    """
    length, across = 0.0, 0.0
    for i in range(3):
        length += near[0, i] ** 2
        across += near[1, i] ** 2
    by = 1.0 / max(math.sqrt(length), 1e-12)
    distance = z[0] if math.isfinite(z[0]) else 1.0 / max(math.sqrt(across), 1e-9)
    shared = max(1.0, cfg[cfg.size - 1] * distance)
    R[0, 0] += shared * _sagitta(near, distance, P)
    bend = np.empty((3, 3))
    for k in range(1, 3):
        for i in range(3):
            for j in range(3):
                s = 0.0
                for r in range(3):
                    s += (near[k, i] * near[0, r] + near[0, i] * near[k, r]) * P[r, j]
                bend[i, j] = s * by / max(distance, 1e-3)
        R[k, k] += shared * _of_square(bend)


@njit(cache=True)
def deviation_second_order(z, near, P, first, cfg, R):
    """What the linear equation of a compass leaves out of its deviation, added to R (1, 1): an error of the heading
    changes what one of the deviation does (Gelb, 1974, sec. 6.1).

    A compass that errs slowly and scatters little seems to be read exactly; without this term, deviations of degrees
    beside a heading known to one were learnt from it. Arguments as for `iron_second_order`.
    """
    s1, c1, s2, c2 = near[0, 10], near[0, 11], near[0, 12], near[0, 13]
    turns, own, both = (c1, -s1, 2.0 * c2, -2.0 * s2), 0.0, 0.0
    for i in range(4):
        both += turns[i] * P[8, first + 1 + i]
        for j in range(4):
            own += turns[i] * P[first + 1 + i, first + 1 + j] * turns[j]
    R[0, 0] += cfg[4] * (own * P[8, 8] + both * both)


@njit(cache=True)
def tilt_second_order(z, near, P, first, cfg, R):
    """What the linear equation of `magnetometer` leaves out of the tilt, added to R (1, 1): a tilt along the azimuth
    changes what one across it does, by the tangent of the dip each (Gelb, 1974, sec. 6.1).

    After the first readings the heading follows the tilt, and what is measured of both is known, however little each of
    them is: the tilt counts by itself. Arguments as for `iron_second_order`; it is the same as long as that is.
    """
    a0, a1 = near[0, 6], near[0, 7]  # across the azimuth; along it (a1, -a0)
    aa = a0 * a0 * P[6, 6] + 2.0 * a0 * a1 * P[6, 7] + a1 * a1 * P[7, 7]
    bb = a1 * a1 * P[6, 6] - 2.0 * a0 * a1 * P[6, 7] + a0 * a0 * P[7, 7]
    ab = a0 * a1 * (P[6, 6] - P[7, 7]) + (a1 * a1 - a0 * a0) * P[6, 7]
    R[0, 0] += cfg[5] * (aa * bb + 2.0 * ab * ab + CUBE * aa * aa * aa)


@njit(cache=True)
def iron_second_order(z, near, P, first, cfg, R):
    """What the linear equation of `magnetometer` leaves out of its iron, added to R (1, 1): an error of the field along
    the azimuth changes what one across it does (Gelb, 1974, sec. 6.1).

    It is the same as long as the vehicle does not turn: as white noise it gets the power of so many readings, cfg[5].
    near: its Jacobian; P: covariance of all states, those of the sensor's parameters from `first` on. Deviation is in
    it where there is any, see `deviation_second_order`.
    """
    hard, soft = int(cfg[2]), int(cfg[3])
    tilt_second_order(z, near, P, first, cfg, R)
    if hard != 0 and soft != 0:
        deviation_second_order(z, near, P, first, cfg, R)
    m0, m1, m2, s = z[0], z[1], z[2], 9 + soft
    if hard >= 0:
        p0, p1, p2 = -near[0, 9 + hard], -near[0, 10 + hard], -near[0, 11 + hard]
    else:
        by = 1.0 / max(m0 * m0 + m1 * m1, 1e-300)
        p0 = by * (near[0, s] * m0 + near[0, s + 2] * m1)
        p1 = by * (near[0, s + 2] * m0 - near[0, s] * m1)
        p2 = by * ((near[0, s + 3] - p0 * m2) * m0 + (near[0, s + 4] - p1 * m2) * m1)
    # p: across the azimuth, level; u: along it
    h = 1.0 / math.sqrt(max(p0 * p0 + p1 * p1 + p2 * p2, 1e-300))
    p0, p1, p2 = h * p0, h * p1, h * p2
    down = math.sqrt(max(m0 * m0 + m1 * m1 + m2 * m2 - h * h, 0.0))
    if near[0, 6] * math.cos(cfg[0]) + near[0, 7] * math.sin(cfg[0]) > 0.0:
        down = -down
    by = 1.0 / (h * h + down * down)
    u0 = by * (h * m0 + down * (p1 * m2 - p2 * m1))
    u1 = by * (h * m1 + down * (p2 * m0 - p0 * m2))
    u2 = by * (h * m2 + down * (p0 * m1 - p1 * m0))
    k = near.shape[1] - 9
    across, along = np.zeros(k), np.zeros(k)
    for row, q0, q1, q2 in ((across, p0, p1, p2), (along, u0, u1, u2)):
        if hard >= 0:
            row[hard], row[hard + 1], row[hard + 2] = -q0, -q1, -q2
        if soft >= 0:
            row[soft], row[soft + 1], row[soft + 2] = q0 * m0 - q1 * m1, q2 * m2, q0 * m1 + q1 * m0
            row[soft + 3], row[soft + 4] = q0 * m2 + q2 * m0, q1 * m2 + q2 * m1
    pp, pu, uu = 0.0, 0.0, 0.0
    for i in range(k):
        for j in range(k):
            c = P[first + i, first + j]
            pp, pu, uu = pp + across[i] * c * across[j], pu + across[i] * c * along[j], uu + along[i] * c * along[j]
    R[0, 0] += cfg[5] * (pp * uu + 2.0 * pu * pu) / (h * h * h * h)


# Errors in variables: a slope that is estimated itself tells of a state no more than it is known (Fuller, 1987).


@njit(cache=True, **UNCOUNTED)
def turns_with_heading(P, north, east):
    """Whether this velocity is known in the vehicle's axes, so that by more than half it turns with the heading's
    error. Fixes tell it from north on: then it does not.
    """
    return P[4, 8] * north - P[3, 8] * east >= 0.5 * P[8, 8] * (north * north + east * east)


@njit(apart=True, cache=True, **UNCOUNTED)
def attitude_second_order(P, acc, nav, own, work):
    """Before a fold of an inertial drive: what its linear transition leaves out of errors of the attitude.

    A tilt takes g / 2 times its square from the vertical force. It lasts, and a depth gauge that sees the height fall
    would tell tilt and velocities by it. So the vertical velocity gets white noise with the power that this has at low
    frequencies, `TILT_SQUARED` times the mean square of the squared tilt; none where the state goes back from a reading
    ahead of the drive.

    A heading error turns the change of velocity. But an error of tilt or of an accelerometer looks like one too, and as
    much of its square as that has variance would be information about the heading out of nothing: errors in variables
    (Fuller, 1987, sec. 1.1). The part of the square beyond its variance is unbiased, and shrinks the slope. work: 2m.

    Not where the velocity turns with the heading before the fold, own: see `turns_with_heading`. What was felt wrongly
    is in that velocity, too, and turned by the same heading error. Nor beside a log (own 2): as much as is taken here
    from what turns with the heading would be news to it, for it reads how the velocity changes in the vehicle's axes.
    """
    m, north, east = acc.shape[1], acc[3, 8], acc[4, 8]
    xx, yy, xy = P[6, 6], P[7, 7], P[6, 7]
    acc[m + 5, 5] += TILT_SQUARED * max(acc[2, 5], 0.0) * (3.0 * (xx * xx + yy * yy) + 2.0 * xx * yy + 4.0 * xy * xy)
    if own > 1.0 or (own != 0.0 and turns_with_heading(P, nav[3] - east, nav[4] + north)):
        return
    variance, own, carried = acc[m + 3, 3] + acc[m + 4, 4], work[:m], work[m : 2 * m]
    for axis in (3, 4):
        for i in range(m):
            own[i] = acc[axis, i]
        own[axis] -= 1.0
        own[8] = 0.0
        weighted(own, P, carried)
        for i in range(m):
            variance += carried[i] * own[i]
    square = north * north + east * east
    share = 1.0 - variance / square if square > variance else 0.0
    for i in (0, 1, 3, 4):
        acc[i, 8] *= share


@njit(apart=True, cache=True, **UNCOUNTED)
def velocity_band(P, near, begin, first, turned):
    """By how much a velocity as it is read may be off, as a slope by which something is told: `HELD` sd.

    near (a, 9 + parameters): its Jacobian; first: where the sensor's parameters stand in P; turned: by how much the
    noise of the gyros moves the instrument [m^2/s^2], the largest of its axes. Those before `begin` are a current: of
    the velocity through the water it is the difference that counts, which a log tells well where velocity and current
    are both unknown.
    """
    most = 0.0
    for i in range(near.shape[0]):
        variance = 0.0
        for j in range(9 + begin):
            f, row = near[i, j], j if j < 9 else first + j - 9
            if f != 0.0:
                s = 0.0
                for k in range(9):
                    s += P[row, k] * near[i, k]
                for k in range(begin):
                    s += P[row, first + k] * near[i, 9 + k]
                variance += f * s
        most = max(most, variance)
    return HELD * math.sqrt(most + turned)


@njit(cache=True, inline="always")
def held_slope(new, old, band):
    """A slope that is a velocity, of a scale or a misalignment: it follows the velocity no closer than it is known.

    The estimate errs by what the next residual shows. Such an error in the slope would be a change of velocity that
    nobody has made, and be taken for what the scale does with it, always to the same side: errors in variables (Fuller,
    1987, sec. 1.1). So a slope goes to the new one slowly, unless that is further off than the band. Were it to stay, a
    turn would leave it off by as much, and each leg would tell something else of the constant.
    """
    return old + FOLLOWED * (new - old) if abs(new - old) <= band else new


@njit(apart=True, cache=True, **UNCOUNTED)
def limit_velocity_slopes(P, near, held, begin, first, turned):
    """Hold the slopes of a velocity by its scale and misalignment, see `held_slope`: in columns from 9 + begin on of
    near the new ones; held (a, k): those of the reading before. The rest as for `velocity_band`.
    """
    band = velocity_band(P, near, begin, first, turned)
    for i in range(near.shape[0]):
        for j in range(held.shape[1]):
            near[i, 9 + begin + j] = held_slope(near[i, 9 + begin + j], held[i, j], band)


@njit(apart=True, cache=True, **UNCOUNTED)
def limit_unread_slopes(P, near, res, first):
    """Slopes of a velocity by the attitude, where not all components are read: one that is not counts as far as it
    stands out of its own uncertainty. Whether three are read at least.

    An error of the attitude turns the component that nobody reads into one that is read. But what is known of it comes
    from elsewhere, through the same attitude: it errs, and as much of its square as is error would be information
    about the attitude out of nothing (Fuller, 1987, sec. 1.1). near (a, 9 + parameters), res (a,): NaN where a
    component is not read; first: where the sensor's parameters stand in P. Beams, none of which is orthogonal to
    another, are left alone.
    """
    count = 0
    for i in range(res.size):
        count += not math.isnan(res[i])
    if res.size != 3 or count == 3:
        return count >= 3
    for j in range(3):
        if not math.isnan(res[j]):
            continue
        variance = 0.0
        for i in range(near.shape[1]):
            row, s = i if i < 9 else first + i - 9, 0.0
            for k in range(near.shape[1]):
                s += P[row, k if k < 9 else first + k - 9] * near[j, k]
            variance += near[j, i] * s
        for i in range(3):
            if math.isnan(res[i]):
                continue
            n0 = near[i, 4] * near[j, 5] - near[i, 5] * near[j, 4]
            n1 = near[i, 5] * near[j, 3] - near[i, 3] * near[j, 5]
            n2 = near[i, 3] * near[j, 4] - near[i, 4] * near[j, 3]
            unread = near[i, 6] * n0 + near[i, 7] * n1 + near[i, 8] * n2
            less = unread if unread * unread <= UNREAD * UNREAD * variance else UNREAD * UNREAD * variance / unread
            near[i, 6] -= less * n0
            near[i, 7] -= less * n1
            near[i, 8] -= less * n2
    return False


@njit(cache=True, **UNCOUNTED)
def limit_clock_slope(P, near, held, column):
    """The slope of a place by the clock that it is stamped with is a velocity, and follows that no closer than it is
    known, as those of `limit_velocity_slopes`.

    Each fix moves the velocity of the state, too: such steps would be changes of velocity that tell the clock. near
    (a, 9 + parameters), of which `column` is the clock's; held (a,): that of the reading before. Readings that see no
    place are left alone: what they see changes with samples of the drive.
    """
    for i in range(near.shape[0]):
        variance = 0.0
        for j in range(3):
            for k in range(3):
                variance += near[i, j] * P[3 + j, 3 + k] * near[i, k]
        new, old = near[i, column], held[i]
        if variance > 0.0 and abs(new - old) <= HELD * math.sqrt(variance):
            near[i, column] = old + STEADY * (new - old)


@njit(cache=True, **UNCOUNTED)
def discount_clock(inner, slope, then, drv, Cr, over_s, gravity, variance, pushes, shared, near, R):
    """Let what a reading tells of a clock, in the last column of near, count as far as its slope stands out of the
    drive's noise. The rest, which `shared` readings have in common, and what is not straight go into R (second
    order, Gelb, 1974, sec. 6.1).

    inner: Jacobian at the state `then`; slope: see `measurement.earlier`, a mean over `over_s`; gravity: 0 where
    forces are accelerations; variance: of the clock; pushes (3, 3): see `acceleration_covariance`.
    """
    k, last = Cr.shape[1] - 1, near.shape[1] - 1
    by = drv[strapdown.PERIOD_S] / over_s if gravity != 0.0 else 2.0 / max(over_s, drv[strapdown.PERIOD_S]) ** 2
    for i in range(near.shape[0]):
        noise, growth, u = 0.0, 0.0, inner[i]
        for j in range(9):
            growth += u[j] * slope[1, j]
        for j in range(3):
            turned = u[6] * then[6 + j] + u[7] * then[9 + j] + u[8] * then[12 + j]
            pushed = u[3] * then[6 + j] + u[4] * then[9 + j] + u[5] * then[12 + j]
            noise += by * (turned * turned * Cr[j, k] + pushed * pushed * Cr[3 + j, k])
        for j in range(3):
            for r in range(3):
                noise += u[3 + j] * pushes[j, r] * u[3 + r]
        told, least = near[i, last], TOLD * TOLD * noise
        if math.isnan(told):
            continue  # there is no reading of this component
        left = told if told * told <= least else least / told
        near[i, last] -= left
        R[i, i] += shared * variance * (noise + left * left) + 0.5 * (variance * growth) ** 2


@njit(apart=True, cache=True, **UNCOUNTED)
def acceleration_covariance(P, nav, drv, Cr, pushes, work):
    """Covariance of an inertial unit's acceleration in n, into `pushes` (3, 3): by tilt and by errors of the
    accelerometers, with all that is known of both. At rest a bias looks like an acceleration, and what a velocity
    tells is the sum of them. work: 3 (k + 3) elements.
    """
    for i in range(3):
        for j in range(3):
            pushes[i, j] = 0.0
    if drv[strapdown.INERTIAL] == 0.0:
        return
    k, g, count = Cr.shape[1] - 1, strapdown.gravity(nav[0], nav[2]), 2
    # errors that accelerate are few, tilts and states of the accelerometers: a row each of how, where it stands
    J, which = shaped(work, k + 3, 3), flat(scratch(np.int64, int(1), k + 3))
    J[0, 0], J[0, 1], J[0, 2], which[0] = 0.0, g, 0.0, 6
    J[1, 0], J[1, 1], J[1, 2], which[1] = -g, 0.0, 0.0, 7
    for s in range(k):
        x, y, z = Cr[3, s], Cr[4, s], Cr[5, s]
        if x != 0.0 or y != 0.0 or z != 0.0:
            for i in range(3):
                J[count, i] = -(nav[6 + 3 * i] * x + nav[7 + 3 * i] * y + nav[8 + 3 * i] * z)
            which[count] = 9 + s
            count += 1
    for c in range(count):
        for i in range(3):
            with_c = 0.0
            for r in range(count):
                with_c += J[r, i] * P[which[r], which[c]]
            for j in range(3):
                pushes[i, j] += with_c * J[c, j]


# Constants that are considered, not estimated (Schmidt, 1966).


@njit(apart=True, cache=True, **UNCOUNTED)
def store_constants(P, x, at, kept):
    """Note what is known of constants from `at` on before a reading corrects, for `consider`.

    kept (1 + constants, `lanes` of them): estimates; then their rows of P, from their columns on, or so many from
    the end.
    """
    n, (rows, most), whole, to = P.shape[0], kept.shape, flat(P), flat(kept)
    first = min(at, n - most)
    for i in range(rows - 1):
        kept[0, i] = x[at + i - 9]
        for j in range(0, most, LANES):
            put(to, (1 + i) * most + j, eight(whole, (at + i) * n + first + j))


@njit(apart=True, cache=True, **UNCOUNTED)
def consider(P, x, kept, at, untold):
    """Take back what a reading has told of constants that are only considered (Schmidt, 1966): slopes and
    correlations with all else stay, and they are known as before. The smoother takes them for constants that walk
    by as much.

    kept: see `store_constants`; untold: of the states from `at` on, not 0 for those that are so.
    """
    n, most, whole, given = P.shape[0], kept.shape[1], flat(P), flat(kept)
    first, meant = min(at, n - most), flat(scratch(np.float64, int(1), most))
    for j in range(most):
        meant[j] = untold[first + j - at] if 0 <= first + j - at < untold.size else 0.0
    for i in range(untold.size):
        if untold[i] == 0.0:
            continue
        x[at + i - 9] = kept[0, i]
        for j in range(0, most, LANES):
            place, before = (at + i) * n + first + j, eight(given, (1 + i) * most + j)
            put(whole, place, if_below(all_of(0.0), eight(meant, j), before, eight(whole, place)))


@njit(apart=True, cache=True, **UNCOUNTED)
def consider_lever_arm(P, x, near, kept, own, at, drv, Cr, untold):
    """Have a lever arm only considered where its slopes do not stand out of the noise of the gyros.

    A rate that is noise is in the attitude, too, and by gravity in what the next readings show: an arm would be
    drawn by both, always to the same side.

    near (a, 9 + parameters): slopes, those by the arm from column 9 + own on; at: where the arm stands in P; drv,
    Cr: the drive's memory, and its white variances in the last column; untold (3,): work. The others: `consider`.
    """
    k = Cr.shape[1] - 1
    if drv[strapdown.INERTIAL] == 0.0:
        return
    share = min(1.0, drv[strapdown.PERIOD_S] / WINDOW_S)
    least = TOLD_ARM * TOLD_ARM * share * max(Cr[0, k], Cr[1, k], Cr[2, k])
    for i in range(3):
        untold[i] = 1.0 if _square(near, 9 + own + i) <= least else 0.0
    consider(P, x, kept, at, untold)


@njit(cache=True, **UNCOUNTED)
def _square(near, column):
    """Of the length of a column, NaN being components that are missing."""
    s = 0.0
    for i in range(near.shape[0]):
        if not math.isnan(near[i, column]):
            s += near[i, column] * near[i, column]
    return s


@njit(apart=True, cache=True, **UNCOUNTED)
def consider_hidden(P, x, H, K, kept, at, untold):
    """Have constants only considered where what they do to a reading does not stand out of what the state's error
    does to it: scales and misalignments of an inertial unit, and of wheels.

    The slope by a scale of the unit is the sample itself, with the noise that has made the state err since: each
    reading that shows this error seems to say that the scale is 1. Summed up over samples, and freed of what other
    constants explain, the slope stands in P, and so does the error. What is drawn draws others that go with it.

    H (a, n), K (n, a): Jacobian and gain; untold (constants,): work. The others: `consider`.
    """
    _hidden(P, H, K, kept, at, untold)
    consider(P, x, kept, at, untold)


@njit(cache=True, **UNCOUNTED)
def _hidden(P, H, K, kept, at, untold):
    a, known, first = H.shape[0], 0.0, min(at, P.shape[0] - kept.shape[1])
    for c in range(a):
        for i in range(H.shape[1]):
            if H[c, i] != 0.0:
                known += H[c, i] * K[i, c]
    for i in range(untold.size):
        before = kept[1 + i, at + i - first]
        untold[i] = 1.0 if before - P[at + i, at + i] < TOLD * TOLD * known * before * before else 0.0


@njit(apart=True, cache=True, **UNCOUNTED)
def consider_unit(P, x, H, K, kept, at, untold, drv, Cr):
    """`consider_hidden` of scales and misalignments of an inertial unit, whose biases are told instead.

    A scale is told beside a bias, gravity times the one from the other, by readings of what both do together. Were the
    scale's share of a correction left out, that would stay wrong: the innovations would have a mean for minutes. So the
    bias takes what the scale would have done to the last sample: that is the gain K + d, d = -K in rows of the scales
    and their slope times it in those of the biases, and P becomes larger by d S d'.

    drv, Cr: the drive's memory, and how its states make the errors of its values. The others: `consider_hidden`.
    """
    _hidden(P, H, K, kept, at, untold)
    n, first, states = untold.size, min(at, P.shape[0] - kept.shape[1]), Cr.shape[1] - 1 - untold.size
    per = drv[strapdown.PERIOD_S] if drv[strapdown.INCREMENTS] != 0.0 else 1.0
    bias, slope = scratch(np.int64, int(1), n), scratch(np.float64, int(1), n)
    for i in range(n):
        element, most, bias[0, i], slope[0, i] = int(drv[strapdown.ELEMENTS + i]), 0.0, 9, 0.0
        for j in range(states):
            f = Cr[strapdown.OF_READING[element], j]
            if untold[i] != 0.0 and f * f * P[9 + j, 9 + j] > most:
                most, bias[0, i] = f * f * P[9 + j, 9 + j], 9 + j
                slope[0, i] = drv[strapdown.PREVIOUS + strapdown.BY_AXIS[element]] / per / f
    # first what is between biases and scales, while rows of the scales are what the reading has made of them
    for i in range(n):
        if slope[0, i] != 0.0:
            b = bias[0, i]
            x[b - 9] += slope[0, i] * (x[at + i - 9] - kept[0, i])
            for j in range(n):
                if untold[j] != 0.0:
                    q = kept[1 + i, at + j - first] - P[at + i, at + j]
                    P[b, at + j] -= slope[0, i] * q
                    P[at + j, b] = P[b, at + j]
                    P[b, bias[0, j]] += slope[0, i] * slope[0, j] * q
    consider(P, x, kept, at, untold)


# The error that is left after a correction, expressed at the corrected attitude (Markley, 2003; Huang et al., 2010).


@njit(cache=True, inline="always")
def _both_tilts(whole, at, j, c, half):
    """The rows of the two tilts, which begin at `at`, turned: eight numbers from j on of each."""
    u, v = eight(whole, at[0] + j), eight(whole, at[1] + j)
    return times(c, u) - times(half, v), times(c, v) + times(half, u)


@njit(cache=True, **UNCOUNTED)
def reset_heading(M, half):
    """M <- G M G' for the rotation of the tilts by half of what the heading turns, to second order. M: symmetric."""
    n, whole, c = M.shape[0], flat(M), 1.0 - 2.0 * half * half / 3.0
    at, many, by = (6 * n, 7 * n), all_of(c), all_of(half)
    last = n - WIDE
    u, v = _both_tilts(whole, at, last, many, by)  # overlaps those before
    for j in range(0, last, WIDE):
        p, q = _both_tilts(whole, at, j, many, by)
        put(whole, at[0] + j, p)
        put(whole, at[1] + j, q)
    put(whole, at[0] + last, u)
    put(whole, at[1] + last, v)
    symmetric.mirror_rows(M, int(6), int(8))
    for i in range(6, 8):
        a, b = M[i, 6], M[i, 7]
        M[i, 6] = c * a - half * b
        M[i, 7] = c * b + half * a
    symmetric.symmetrise(M, int(6), int(9))


@njit(cache=True, inline="always")
def _with_turned(whole, n, first, of, j, x, y, z):
    """Eight numbers from column j on of three rows, with the cross products added: see `add_turned`."""
    u, v, w = eight(whole, of * n + j), eight(whole, (of + 1) * n + j), eight(whole, (of + 2) * n + j)
    a, b, c = eight(whole, first * n + j), eight(whole, (first + 1) * n + j), eight(whole, (first + 2) * n + j)
    return (a + (times(v, z) - times(w, y)), b + (times(w, x) - times(u, z)), c + (times(u, y) - times(v, x)))


@njit(cache=True, **UNCOUNTED)
def add_turned(M, first, of, x, y, z):
    """Add to three rows and columns of M, which is symmetric, the cross products of three others with (x, y, z)."""
    n, whole, p, q, r = M.shape[0], flat(M), all_of(x), all_of(y), all_of(z)
    last = n - WIDE
    d, e, f = _with_turned(whole, n, first, of, last, p, q, r)  # overlaps those before
    for j in range(0, last, WIDE):
        a, b, c = _with_turned(whole, n, first, of, j, p, q, r)
        put(whole, first * n + j, a)
        put(whole, (first + 1) * n + j, b)
        put(whole, (first + 2) * n + j, c)
    put(whole, first * n + last, d)
    put(whole, (first + 1) * n + last, e)
    put(whole, (first + 2) * n + last, f)
    symmetric.mirror_rows(M, first, first + 3)
    for j in range(first, first + 3):
        u, v, w = M[j, of], M[j, of + 1], M[j, of + 2]
        M[j, first] += v * z - w * y
        M[j, first + 1] += w * x - u * z
        M[j, first + 2] += u * y - v * x
    symmetric.symmetrise(M, first, first + 3)


@njit(apart=True, cache=True, **UNCOUNTED)
def turn_velocity(P, nav, before, change):
    """After a velocity in the vehicle's axes has changed the estimate: what a rotation does to the velocity it also
    does to the change. before: the three of the velocity until then; change (3,) is written for the smoother.

    What is known is the velocity in the vehicle's axes. An error psi of the attitude turns it, by ``psi x v``, so the
    covariance with the attitude has to follow v. Else what a reading changes would be something that does not turn with
    the rest, and the next reading would tell the heading from the noise of this one; an invariant error state (Barrau
    and Bonnabel, 2017, IEEE Trans. Automatic Control 62) has that by its coordinates.
    """
    north, east, down = nav[3] - before[0], nav[4] - before[1], nav[5] - before[2]
    change[0], change[1], change[2] = north, east, down
    add_turned(P, int(3), int(6), north, east, down)


@njit(cache=True, **UNCOUNTED)
def reset_tilts(M, p, q):
    """M <- G M G' for the rotation of the attitude by half a change of the tilts, to first order. M: symmetric."""
    n = M.shape[0]
    for j in range(n):
        u, v, w = M[6, j], M[7, j], M[8, j]
        M[6, j], M[7, j], M[8, j] = u + q * w, v - p * w, w + p * v - q * u
    symmetric.mirror_rows(M, int(6), int(9))
    for i in range(6, 9):
        u, v, w = M[i, 6], M[i, 7], M[i, 8]
        M[i, 6], M[i, 7], M[i, 8] = u + q * w, v - p * w, w + p * v - q * u
    symmetric.symmetrise(M, int(6), int(9))


@njit(apart=True, cache=True, **UNCOUNTED)
def turn_tilts(P, K, res, change):
    """After a reading where no velocity in the vehicle's axes has been used: the attitude's error left over is
    expressed at the corrected tilts, too, by the first order of the Jacobian of `correct`.

    Fixes tell tilts in north and east, by how the velocity changes. What is left of a tilt's error has a part about the
    axis that the heading turns about; without it the tilt was surer of the heading than it could be. K (n, a), res
    (a,): gain and residuals of the reading; change (2,) is written for the smoother.
    """
    north, east = 0.0, 0.0
    for r in range(len(res)):
        north += K[6, r] * res[r]
        east += K[7, r] * res[r]
    change[0], change[1] = north, east
    reset_tilts(P, 0.5 * north, 0.5 * east)


@njit(cache=True, **UNCOUNTED)
def deviation_change(K, res, first):
    """What turning by one does to the change of a deviation: to sine and cosine of the heading, and of twice it."""
    return K[first + 1] * res, -K[first] * res, 2.0 * K[first + 3] * res, -2.0 * K[first + 2] * res


@njit(apart=True, cache=True, **UNCOUNTED)
def _turn_states(P, by, first):
    """Let states from `first` on follow an error of the heading: `by` is what turning by one does to the change of
    each. P is symmetric.
    """
    n, whole, end = P.shape[0], flat(P), first + len(by)
    own, last = 8 * n, n - WIDE
    for i in range(len(by)):
        row, f = (first + i) * n, all_of(by[i])
        overlapping = eight(whole, row + last) + times(f, eight(whole, own + last))
        for j in range(0, last, WIDE):
            put(whole, row + j, eight(whole, row + j) + times(f, eight(whole, own + j)))
        put(whole, row + last, overlapping)
    symmetric.mirror_rows(P, first, end)
    for j in range(first, end):
        f = P[j, 8]
        for i in range(len(by)):
            P[j, first + i] += by[i] * f
    symmetric.symmetrise(P, first, end)


@njit(apart=True, cache=True, **UNCOUNTED)
def turn_deviation(P, K, res, first):
    """After a compass has changed its own deviation: what an error of the heading does to the deviation it also does to
    the change. K (n,): its gain; first: where sine and cosine of the heading, and of twice it, begin.

    Readings tell no heading from a deviation: were the vehicle turned by psi, a bias less by psi and a deviation that
    is turned with it would have them read the same. So errors of the heading and of the deviation go together by what
    that is, and have to follow it. Else each reading would tell a little of the heading by how its slope has changed
    (Huang, Mourikis and Roumeliotis, 2010, International Journal of Robotics Research 29).
    """
    _turn_states(P, deviation_change(K, res, first), first)


@njit(cache=True, **UNCOUNTED)
def current_change(K, res, first):
    """What turning by one does to the change of a current north and east: K (n, a), res (a,)."""
    north, east = 0.0, 0.0
    for r in range(len(res)):
        north += K[first, r] * res[r]
        east += K[first + 1, r] * res[r]
    return -east, north


@njit(apart=True, cache=True, **UNCOUNTED)
def turn_current(P, K, res, first):
    """With `turn_velocity`: a current, north and east from `first` on, turns with the heading as the velocity does.

    A log knows the difference of the two in the vehicle's axes. What a reading makes of it is mostly a change of the
    one that is known less, the current; did that not follow the heading, the next reading would tell the heading from
    the noise of this one. K (n, a), res (a,): gain and residuals of the reading.
    """
    _turn_states(P, current_change(K, res, first), first)


@njit(cache=True, inline="always")
def turn_back(L, lam, by, first):
    """`_turn_states` backward."""
    n = len(lam)
    for i in range(len(by)):
        lam[8] += by[i] * lam[first + i]
        for j in range(n):
            L[8, j] += by[i] * L[first + i, j]
    for i in range(len(by)):
        for j in range(n):
            L[j, 8] += by[i] * L[j, first + i]
