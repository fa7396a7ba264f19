"""Mechanisation kernels: Earth, strapdown integration, dead reckoning, and the compound transition that goes with them.

Arrays shared with the navigator (all float64, C-contiguous):

``nav`` (17,)   latitude, longitude [rad], height [m], velocity_n (3) [m/s], C_nb row by row (9), meridian and
prime-vertical
                radius plus height [m].
``drv`` (198,)  memory and settings of the drive, see the index constants below. ``samples`` (n, 7)  seconds since the
previous sample, then the six values of the drive. ``Cr`` (6, k+1) output rows C of the drive's error blocks, and in the
last column the white variance of one sample. ``acc`` (4m, m) compound transition Phi and noise Q since the last fold (m
rows each), then two m-row work areas. m = 9 + k.

Signs: error = estimated minus true; attitude error is a rotation vector in n: ``C_est = exp([phi x]) C_true``.
"""

import math

import numpy as np

from navfilter.kernels.compiling.decorators import COUNTED, UNCOUNTED, flat, njit, scratch
from navfilter.kernels.compiling.registers import all_of, eight, exchange, if_below, load, put, store, times, transpose
from navfilter.kernels.compiling.vectors import COLUMNS, build_panels

EARTH_RADIUS = 6378137.0  # WGS-84 semi-major axis [m]
EARTH_E2 = 6.69437999014e-3  # first eccentricity squared
EARTH_RATE = 7.292115e-5  # [rad/s]
GRAVITY_EQUATOR = 9.7803253359  # Somigliana [m/s^2]
GRAVITY_POLE = 9.8321849378
GRAVITY_SLOPE = 2.0 / EARTH_RADIUS  # relative decrease per metre of height
# The square of an angle [rad^2] below which a rotation is a series; one by the factorials of 3, 5, 7 and 4, 6, 8.
SMALL_ANGLE2, P3, P5, P7 = 1e-3, 1.0 / 6.0, 1.0 / 120.0, 1.0 / 5040.0
Q4, Q6, Q8 = 1.0 / 24.0, 1.0 / 720.0, 1.0 / 40320.0
SOMIGLIANA = math.sqrt(1.0 - EARTH_E2) * GRAVITY_POLE / GRAVITY_EQUATOR - 1.0

# Places in drv. Memory: previous sample (6), increments consumed by holds since (6), their seconds, mean attitude of
# the last step, sums and squares for the detection of rest. Settings: the rest.
PREVIOUS, CONSUMED, HELD_S, STARTED, MEAN_C, COUNT, SUMS, SQUARES = 0, 6, 12, 13, 14, 23, 24, 30
GAP_TILT, GAP_TILT_S = 0.1, 30.0  # rad; a random walk gets there in so long [s]
BLIND_TILT = 0.1  # of an attitude that is not read: 0.3 rad, a dive, in 10 s [rad/sqrt(s)]
STUCK_S, STUCK_PERIODS = 8.0, 20.0  # readings that are the same for longer, and for so many periods, are stuck
# A heading that came again in less than this share of so many samples or more has a digit for its noise, and does not
# stand still on a straight way; so many are remembered, and of a run no more than so many.
OFTEN, KNOWN_SAMPLES, REPEATS_SAMPLES, COUNTED_PERIODS = 0.1, 100.0, 2000.0, 5.0
# No vehicle turns or accelerates so fast [rad/s], [m/s^2], beside what a reading scatters [rad], [m/s]; after so many
# in a row that seem to say so it is there to stay.
MOST_TURN, MOST_ACCELERATION, SCATTER_RAD, SCATTER_M_S, MOST_ODD = 1.5, 5.0, 0.1, 0.5, 2.0
GAP_TURN = 0.35  # what a vehicle turns by unseen: 0.2 rad/s for some 3 s [rad/sqrt(s)]
PERIOD_S, INCREMENTS, GAP_RATE_SD, GAP_FORCE_SD = 36, 37, 38, 39
HOLD_DENSITY, DEVIATION, SCALE, DECLINATION, LEVER, MOUNTING = 40, 41, 42, 43, 44, 47
LEVER_VELOCITY, PREVIOUS_RPY = 56, 59
MAX_SPEED, ZERO_IS_VALID = 62, 63
TURN_RATE = 64
# Dead reckoning whose clocks or lever arm are states: their places among the drive's states (-1: none); how fast the
# six readings change (6), the last velocity that was one and whether there is one (4), and what the last turn did to a
# lever arm, per second (9).
ATTITUDE_CLOCK, VELOCITY_CLOCK, ARM, CHANGE, PREVIOUS_VELOCITY, KNOWN_VELOCITY, ARM_TURN = 65, 66, 67, 68, 74, 77, 78
# 1: dead reckoning has a scale of the velocity for each axis, 0: one for all.
SCALE_STEP = 87
# An inertial unit that is not calibrated, true = reading - M reading - errors: how many elements of M are states, the
# last of the drive's; which they are (3 * channel + axis each); and what all 18 are thought to be, 0 for the others.
CALIBRATED, ELEMENTS, CALIBRATION = 88, 89, 107
# Which of the six readings an element of M is for, and by which of them it goes.
OF_READING, BY_AXIS = np.arange(18) // 3, np.arange(18) // 9 * 3 + np.arange(18) % 3
# Dead reckoning through water: place of the current, north and east, among the drive's states (-1: over ground).
CURRENT = 125
# 0: no inertial unit. `FELT`: accelerations carry the velocity. `UNFELT`: no force of the unit is used. Nobody knows
# what the velocity does then, but no tilt turns gravity into it.
INERTIAL = 126
FELT, UNFELT = 1.0, 2.0
# Dead reckoning: the way made by its own readings, north and east [m], whatever has been corrected since; for how long
# there has been no attitude, and no velocity [s]; for how long the three angles have been the same to the last bit, and
# the three velocities, none of them zero [s].
WAY, BLIND_S, LOST_S, SAME_ATTITUDE_S, SAME_VELOCITY_S, PREVIOUS_VELOCITY_B = 127, 129, 130, 131, 132, 133
# Samples in a row that no vehicle can make of the one before, of the heading and of the velocity; and the last velocity
# that was taken, for how long it is the last [s], negative before the first.
ODD_HEADING, ODD_VELOCITY, GOOD_VELOCITY, GOOD_S = 136, 137, 138, 141
PLACES = [DEVIATION, SCALE, ARM, ATTITUDE_CLOCK, VELOCITY_CLOCK, CURRENT]
# 1: a velocity in the vehicle's axes has been used, see `consistency.turns_with_heading`; 2: and there is a current.
OWN = 142
# Dead reckoning: how the vehicle goes on beyond the last sample, turning (3) [rad/s], and gaining velocity (3) [m/s^2],
# in b, each followed by what it did between the last two readings (3); and by how much that was another before.
TURNING, RATE, GAINING, TURN_CHANGE, SPEED_CHANGE = 143, 146, 149, 155, 156
# Dead reckoning: sd of the errors of its six readings, these as slopes by constants see them (6 each); their attitude
# (9), how it turned, per second (9); how fast the velocity changed at the reading before, as far as that stands out of
# noise (3); and by how much the trapezoidal rule is ahead of the way [m] (3).
SPREAD, STEADY, STEADY_C, STEADY_TURN, SLOPES, BENT = 157, 163, 169, 178, 187, 190
# Dead reckoning: for how long the heading has been the same to the last bit [s], in which share of its samples it was
# before, and how many these are.
SAME_HEADING_S, REPEATS, SEEN = 193, 194, 195
# Dead reckoning: mean squares of how much turn and change of velocity are others from one interval to the next
# [rad^2/s^2], [m^2/s^4].
TURN_USUAL, SPEED_USUAL = 196, 197
# Dead reckoning: by how much its heading [rad] and its velocity (3) [m/s] have jumped, as no vehicle moves, and stay;
# 0: they have not, or it has been heeded. 1: heading, velocity have jumped, and not back.
JUMPED, AWAY = 198, 202
DRIVE_SIZE = 204
# Slopes go to a new reading slowly, unless that is further off than so many sd of its errors [1].
STEADY_SDS, FOLLOWED = 3.0, 0.02
# What is usual is a mean over so long, two or three dives [s]; at first it is a turn and a push that AUVs begin with
# [rad/s], [m/s^2].
USUAL_S, TURN_BEGUN, SPEED_BEGUN = 60.0, 0.05, 0.05
# The turn that moves an arm counts as far as it stands out of so many sd of its noise: by k of them it draws an arm by
# 1 / k^2 of itself [1].
TOLD_TURN = 10.0
# What changes is a mean over the longer of these [s], for readings are noisy, and over the shorter where it is off by
# so many sd of the noise of a difference. A change counts as far as it stands out of so many sd of its own noise, which
# is in the state's velocity, too: by it depths drew the clock of a velocity that scatters by 1 cm/s to one side, by one
# sd in a quarter of an hour [1]. What wanders stays in the sum of the velocity, and draws harder: the clock of the
# velocity of 187 random vehicles was off by 14 variances with the same factor, by 6 with this one, and one of 20 or 40
# takes more off the clock's true slope than noise adds to it [1].
CHANGE_S, STEADY_S, SUDDEN, TOLD_CHANGE, TOLD_WANDER = 0.1, 1.0, 5.0, 3.0, 10.0
MOST_TICKS = 10000.0  # of the drive's blocks in one step
WIDE = 8  # columns of a panel: rows of so many are one register, or two
# Work of the inertial kernels, one array as every further one costs its call: increments (6), elements of the
# transition (34), rows of errors (6 * WIDE); then how errors enter the readings, one number a pair of `_which_errors`,
# the same of constants, six rows to a panel, and rows of the drive's blocks.
INCREMENT, STEP, ROWS, GAINS = 0, 6, 40, 40 + 6 * WIDE
GAP_PERIODS = 3.0  # a silence of more than this many periods is a gap: what the vehicle did in it is unknown


@njit(cache=True, error_model="numpy", **UNCOUNTED)
def radii(latitude):
    """Meridian and prime-vertical radius of curvature [m] (Groves, 2013, eqs 2.105-2.106)."""
    s = math.sin(latitude)
    x = 1.0 - EARTH_E2 * s * s
    prime = EARTH_RADIUS / math.sqrt(x)
    return prime * (1.0 - EARTH_E2) / x, prime


@njit(cache=True, error_model="numpy", **UNCOUNTED)
def gravity(latitude, height):
    """Normal gravity [m/s^2]: Somigliana, linear in height (Groves, 2013, sec. 2.4.7)."""
    s2 = math.sin(latitude) ** 2
    return GRAVITY_EQUATOR * (1.0 + SOMIGLIANA * s2) / math.sqrt(1.0 - EARTH_E2 * s2) * (1.0 - GRAVITY_SLOPE * height)


@njit(cache=True, error_model="numpy", inline="always")
def rodrigues(t2):
    """Factors a, b of ``exp([v x]) = I + a [v x] + b [v x]^2`` for |v|^2 = t2."""
    if t2 > SMALL_ANGLE2:
        t = math.sqrt(t2)
        return math.sin(t) / t, (1.0 - math.cos(t)) / t2
    # series without divisions, which are slow: the first term left out is below 1e-17
    return 1.0 - t2 * (P3 - t2 * (P5 - P7 * t2)), 0.5 - t2 * (Q4 - t2 * (Q6 - Q8 * t2))


@njit(cache=True, error_model="numpy", inline="always")
def rotated(a, b, x, y, z, u, v, w):
    """The vector (u, v, w) turned: itself + a (x, y, z) x it + b (x, y, z) x ((x, y, z) x it)."""
    f, g, h = y * w - z * v, z * u - x * w, x * v - y * u
    return u + a * f + b * (y * h - z * g), v + a * g + b * (z * f - x * h), w + a * h + b * (x * g - y * f)


@njit(cache=True, error_model="numpy", **COUNTED)
def _product(A, B, out):
    """A B into out, by BLAS. numba wants arrays that are counted for that, see `navfilter.kernels`."""
    np.dot(A, B, out)


@njit(cache=True, error_model="numpy", **UNCOUNTED)
def _compound(acc, m):
    """Phi <- F Phi, Q <- F Q F' with F in the third block of acc; the fourth is the work area.

    Products of this size are three times faster in BLAS than in loops, even skipping the zeros of F, and BLAS with a
    transposed factor three times slower than without (measured at m = 15): Q F' is formed as (F Q)', Q being symmetric.
    """
    Phi, Q, F, T = acc[:m], acc[m : 2 * m], acc[2 * m : 3 * m], acc[3 * m :]
    _product(F, Phi, T)
    for i in range(m):
        for j in range(m):
            Phi[i, j] = T[i, j]
    _product(F, Q, T)
    for i in range(m):
        for j in range(m):
            Q[i, j] = T[j, i]
    _product(F, Q, T)
    for i in range(m):
        for j in range(m):
            Q[i, j] = T[i, j]


@njit(apart=True, cache=True, error_model="numpy", **UNCOUNTED)
def stamps_to_steps(samples, last_s, limits, gap_s, longest_s):
    """Replace the stamps of a block (first column) by seconds since the sample before; returns the number of gaps
    longer than `gap_s`.

    Returns -1, and changes nothing, when a stamp does not come after the one before or more than `longest_s` after it,
    or when one of the first values is not within its limits.
    """
    previous, gaps = last_s, 0
    for n in range(samples.shape[0]):
        if not previous < samples[n, 0] <= previous + longest_s:
            return -1
        gaps += samples[n, 0] - previous > gap_s
        previous = samples[n, 0]
        for j in range(len(limits)):
            if not abs(samples[n, 1 + j]) <= limits[j]:
                return -1
    previous = last_s
    for n in range(samples.shape[0]):
        step = samples[n, 0] - previous
        previous = samples[n, 0]
        samples[n, 0] = step
    return gaps


@njit(cache=True, error_model="numpy", **UNCOUNTED)
def _clear_transition(F, m):
    for i in range(m):
        for j in range(m):
            F[i, j] = 0.0


@njit(cache=True, error_model="numpy", inline="always")
def _increments(samples, n, drv, inc):
    """Angle and velocity increments of sample n from rates or increments: linear-rate coning and sculling (Savage,
    1998).
    """
    dt, whole = samples[n, 0], 1.0
    if drv[STARTED] == 0.0:
        whole = min(
            max(dt / drv[PERIOD_S], 0.0), 1.0
        )  # what the first increments gathered before the start is not ours
        for i in range(6):
            drv[PREVIOUS + i] = samples[n, 1 + i]
        drv[STARTED] = 1.0
    a0, a1, a2, b0, b1, b2 = drv[0], drv[1], drv[2], drv[3], drv[4], drv[5]
    w0, w1, w2 = samples[n, 1], samples[n, 2], samples[n, 3]
    f0, f1, f2 = samples[n, 4], samples[n, 5], samples[n, 6]
    rates = drv[INCREMENTS] == 0.0
    unit = dt * dt / 12.0 if rates else 1.0 / 12.0
    half = 0.5 * dt if rates else whole
    keep = 1.0 if rates else 0.0
    inc[0] = half * (w0 + keep * a0) + unit * (a1 * w2 - a2 * w1)
    inc[1] = half * (w1 + keep * a1) + unit * (a2 * w0 - a0 * w2)
    inc[2] = half * (w2 + keep * a2) + unit * (a0 * w1 - a1 * w0)
    inc[3] = half * (f0 + keep * b0) + unit * (a1 * f2 - a2 * f1 + b1 * w2 - b2 * w1)
    inc[4] = half * (f1 + keep * b1) + unit * (a2 * f0 - a0 * f2 + b2 * w0 - b0 * w2)
    inc[5] = half * (f2 + keep * b2) + unit * (a0 * f1 - a1 * f0 + b0 * w1 - b1 * w0)
    for i in range(6):
        inc[i] -= drv[CONSUMED + i]
        drv[CONSUMED + i] = 0.0
        drv[PREVIOUS + i] = samples[n, 1 + i]


@njit(cache=True, error_model="numpy", inline="always")
def _mechanise(nav, inc, dt, C):
    """One strapdown step from the corrected increments inc = (angle 3, velocity 3).

    C (9,) receives the mean of C_nb over the step. Returns what the transition needs: the velocity increment in n (3),
    the mean velocity (3), gravity, one by each radius, sine and cosine of the latitude before, and its tangent.
    """
    # what is read once the compiler need not fetch again after each number that it writes
    c0, c1, c2, c3, c4, c5, c6, c7, c8 = nav[6], nav[7], nav[8], nav[9], nav[10], nav[11], nav[12], nav[13], nav[14]
    th0, th1, th2, u0, u1, u2 = inc[0], inc[1], inc[2], inc[3], inc[4], inc[5]
    # rotation of the velocity increment within the sample (Savage, 1998, part 2)
    d0 = u0 + 0.5 * (th1 * u2 - th2 * u1)
    d1 = u1 + 0.5 * (th2 * u0 - th0 * u2)
    d2 = u2 + 0.5 * (th0 * u1 - th1 * u0)
    lat, h = nav[0], nav[2]
    vn, ve, vd = nav[3], nav[4], nav[5]
    sl = math.sin(lat)
    cl = math.sqrt(1.0 - sl * sl)  # cheaper than a cosine; a start is never within 0.1 degree of a pole
    # few divisions: they are the dearest operations here
    root = 1.0 / math.sqrt(1.0 - EARTH_E2 * sl * sl)
    re = EARTH_RADIUS * root
    rn = re * (1.0 - EARTH_E2) * root * root + h
    re += h
    by_rn, by_re, tl = 1.0 / rn, 1.0 / re, sl / cl
    an = c0 * d0 + c1 * d1 + c2 * d2
    ae = c3 * d0 + c4 * d1 + c5 * d2
    ad = c6 * d0 + c7 * d1 + c8 * d2
    g = GRAVITY_EQUATOR * (1.0 + SOMIGLIANA * sl * sl) * root * (1.0 - GRAVITY_SLOPE * (h - 0.5 * vd * dt))
    mn, me, md = vn + 0.5 * an, ve + 0.5 * ae, vd + 0.5 * (ad + g * dt)  # velocity at mid-sample
    ien, ied = EARTH_RATE * cl, -EARTH_RATE * sl
    wn, we, wd = ien + me * by_re, -mn * by_rn, ied - me * tl * by_re  # rate of n against inertial space
    on, oe, od = wn + ien, we, wd + ied
    # n turns during the sample: half of its rotation acts on the increment
    pn = an - 0.5 * dt * (we * ad - wd * ae)
    pe = ae - 0.5 * dt * (wd * an - wn * ad)
    pd = ad - 0.5 * dt * (wn * ae - we * an)
    nav[3] = vn + pn - dt * (oe * md - od * me)
    nav[4] = ve + pe - dt * (od * mn - on * md)
    nav[5] = vd + pd - dt * (on * me - oe * mn) + g * dt
    mn, me, md = 0.5 * (vn + nav[3]), 0.5 * (ve + nav[4]), 0.5 * (vd + nav[5])
    hm = -0.5 * md * dt
    dlat = mn * by_rn * (1.0 - hm * by_rn) * dt
    nav[0] = lat + dlat
    nav[1] += me * dt / ((re + hm) * (cl - 0.5 * sl * dlat))
    nav[2] = h - md * dt
    nav[15], nav[16] = rn + 2.0 * hm, re + 2.0 * hm
    # C exp([th x]): each row turned by -th; then exp(-[w dt x]) C: each column turned by -w dt
    a, b = rodrigues(th0 * th0 + th1 * th1 + th2 * th2)
    d0, d1, d2 = rotated(-a, b, th0, th1, th2, c0, c1, c2)
    d3, d4, d5 = rotated(-a, b, th0, th1, th2, c3, c4, c5)
    d6, d7, d8 = rotated(-a, b, th0, th1, th2, c6, c7, c8)
    x, y, z = wn * dt, we * dt, wd * dt
    a, b = rodrigues(x * x + y * y + z * z)
    d0, d3, d6 = rotated(-a, b, x, y, z, d0, d3, d6)
    d1, d4, d7 = rotated(-a, b, x, y, z, d1, d4, d7)
    d2, d5, d8 = rotated(-a, b, x, y, z, d2, d5, d8)
    nav[6], nav[7], nav[8], nav[9], nav[10], nav[11], nav[12], nav[13], nav[14] = d0, d1, d2, d3, d4, d5, d6, d7, d8
    C[0], C[1], C[2] = 0.5 * (c0 + d0), 0.5 * (c1 + d1), 0.5 * (c2 + d2)
    C[3], C[4], C[5] = 0.5 * (c3 + d3), 0.5 * (c4 + d4), 0.5 * (c5 + d5)
    C[6], C[7], C[8] = 0.5 * (c6 + d6), 0.5 * (c7 + d7), 0.5 * (c8 + d8)
    return pn, pe, pd, mn, me, md, g, by_rn, by_re, sl, cl, tl


@njit(cache=True, error_model="numpy", inline="always", **UNCOUNTED)
def _take_errors_off(inc, xd, dt, seen, kinds, gain):
    """The drive's errors off the increments of a step; seen, kinds, gain: as `_which_errors` has it."""
    if kinds[2]:
        for i in range(6):
            inc[i] -= dt * xd[i]
    else:
        for p in range(kinds[1]):
            inc[seen[0, p]] -= dt * gain[p] * xd[seen[1, p]]


@njit(apart=True, cache=True, error_model="numpy", **UNCOUNTED)
def _inertial_advance(nav, dt, drv, work):
    """One strapdown step by increments of which the drive's errors have been taken off; leaves the elements of its
    transition, of second order in dt, in `work` for `_carried`. Where no force is felt it is the one at rest.
    """
    inc, f = work[:STEP], work[STEP:ROWS]
    if drv[INERTIAL] == UNFELT:
        for i in range(3):
            inc[3 + i] = -gravity(nav[0], nav[2]) * dt * nav[12 + i]
    pn, pe, pd, mn, me, md, g, by_rn, by_re, sl, cl, tl = _mechanise(nav, inc, dt, drv[MEAN_C : MEAN_C + 9])
    by_cl = 1.0 / cl
    north, east, down = mn * by_rn, me * by_re, md * by_re  # the same as angles
    wn, we, wd = EARTH_RATE * cl + east, -north, -EARTH_RATE * sl - east * tl
    on, oe, od = wn + EARTH_RATE * cl, we, wd - EARTH_RATE * sl
    bend = EARTH_RATE * cl + east * by_cl * by_cl  # how the turn over ground changes with latitude
    if drv[INERTIAL] == UNFELT:
        pn = pe = pd = 0.0
    f[0], f[1], f[2], f[3], f[4], f[5], f[6] = dt, wn * dt, we * dt, wd * dt, pn, pe, pd
    # attitude by velocity and position
    f[7], f[8], f[9] = -dt * by_re, dt * by_rn, dt * tl * by_re
    f[10], f[11] = dt * EARTH_RATE * sl * by_rn, dt * bend * by_rn
    f[12], f[13], f[14] = -dt * east * by_re, dt * north * by_rn, dt * east * tl * by_re
    # velocity by velocity and position
    f[15], f[16], f[17] = 1.0 + dt * md * by_rn, dt * (od - east * tl), -dt * oe
    f[18], f[19], f[20] = -dt * od, 1.0 + dt * (down + mn * by_re * tl), dt * on
    f[21], f[22] = dt * (oe - north), -dt * (on + east)
    f[23] = -dt * me * (EARTH_RATE * cl + bend) * by_rn
    f[24] = dt * (2.0 * EARTH_RATE * (mn * cl - md * sl) * by_rn + north * east * by_cl * by_cl)
    f[25] = dt * 2.0 * EARTH_RATE * sl * me * by_rn
    f[26] = dt * (north * md * by_rn - east * east * tl)
    f[27] = dt * east * (mn * by_re * tl + down)
    f[28] = dt * (2.0 * g / EARTH_RADIUS - north * north - east * east)
    # position by position
    f[29], f[30], f[31] = 1.0 - dt * md * by_rn, dt * north, dt * me * tl * by_rn
    f[32], f[33] = 1.0 - dt * (down + tl * north), dt * east


def _carried(x, e, f, C, half):
    """Nine rows x of navigation from the left by the transition of one step: attitude, then velocity with the mean
    attitude error, then position with the mean velocity error.

    e: rows of what the errors of the six readings do in the step, if any; f, C: see `_inertial_advance`; half: of the
    step. Only elements that are not zero: ten times as quick as a product of whole matrices. For arrays, and for
    registers.
    """
    tn, te, td, pn, pe, pd = f[1], f[2], f[3], f[4], f[5], f[6]
    y6 = x[6] + td * x[7] - te * x[8] + f[7] * x[4] + f[10] * x[0] + f[12] * x[2]
    y7 = x[7] - td * x[6] + tn * x[8] + f[8] * x[3] + f[13] * x[2]
    y8 = x[8] + te * x[6] - tn * x[7] + f[9] * x[4] + f[11] * x[0] + f[14] * x[2]
    if len(e):
        y6, y7, y8 = (y - (C[i] * e[0] + C[i + 1] * e[1] + C[i + 2] * e[2]) for i, y in ((0, y6), (3, y7), (6, y8)))
    a, b, c = 0.5 * (y6 + x[6]), 0.5 * (y7 + x[7]), 0.5 * (y8 + x[8])
    y3 = f[15] * x[3] + f[16] * x[4] + f[17] * x[5] + f[23] * x[0] + f[26] * x[2] + (b * pd - c * pe)
    y4 = f[18] * x[3] + f[19] * x[4] + f[20] * x[5] + f[24] * x[0] + f[27] * x[2] + (c * pn - a * pd)
    y5 = f[21] * x[3] + f[22] * x[4] + x[5] + f[25] * x[0] + f[28] * x[2] + (a * pe - b * pn)
    if len(e):
        y3, y4, y5 = (y - (C[i] * e[3] + C[i + 1] * e[4] + C[i + 2] * e[5]) for i, y in ((0, y3), (3, y4), (6, y5)))
    y0 = f[29] * x[0] + f[30] * x[2] + half * (y3 + x[3])
    y1 = f[31] * x[0] + f[32] * x[1] + f[33] * x[2] + half * (y4 + x[4])
    return y0, y1, x[2] + half * (y5 + x[5]), y3, y4, y5, y6, y7, y8


def _carry_panel(Z, e, by, f, C):
    """`_carried` of the first nine rows of a panel Z, in place; e: rows of errors, `by` what they are multiplied by."""
    x, e = Z[: 9 * WIDE].reshape(9, WIDE), by * e[: 6 * WIDE].reshape(6, WIDE)
    np.copyto(x, np.array(_carried(x, e, f, C, 0.5 * f[0])))


def _carry_alone(Z, f):
    """`_carry_panel` where no errors enter."""
    x = Z[: 9 * WIDE].reshape(9, WIDE)
    np.copyto(x, np.array(_carried(x, (), f, (), 0.5 * f[0])))


# every step of the filter goes by `imu_steps` or `imu_hold` as they are compiled, so that bits stay the same
build_panels(_carried, _carry_panel, _carry_alone, 34, 9, 6)


@njit(apart=True, cache=True, error_model="numpy", **UNCOUNTED)
def _inertial_carry(X, work, C, seen, kinds, moving, Phi_ends):
    """Rows 0 to 8 of X (panels of matrices with a row for each state that moves) from the left by the transition of one
    step, see `_carried`.

    seen, kinds: as `_which_errors` has it. Rows of errors are put together where states enter the readings in another
    way than plainly. A constant is a unit row of Phi, which ends at `Phi_ends`, and has no noise: to its columns of Phi
    come the rows that `_uncalibrated` leaves, of the whole step.
    """
    count, noisy, plain, varying = kinds
    f, E, gain, G = work[STEP:ROWS], work[ROWS:GAINS], work[GAINS:], work[GAINS + seen.shape[1] :]
    dt, direct, high = f[0], plain and noisy == varying, _high(moving)
    for left in range(0, X.size // high, WIDE):
        begin = left * high
        Z = X[begin : begin + high * WIDE]
        if begin < Phi_ends and left + WIDE <= 9:  # no error depends on navigation
            _carry_alone(Z, f)
            continue
        constant = varying < count and begin < Phi_ends and left + WIDE > moving
        if direct and not constant:
            _carry_panel(Z, Z[9 * WIDE :], dt, f, C)
            continue
        if constant and left >= moving:
            _carry_panel(Z, G[6 * left :], 1.0, f, C)
            continue
        for i in range(6):
            store(E, i, load(Z, 9 + i) if plain else all_of(0.0))
        for p in range(noisy if plain else 0, varying):
            row = seen[0, p]
            store(E, row, load(E, row) + times(all_of(gain[p]), load(Z, 9 + seen[1, p])))
        for i in range(6 if constant else 0):
            store(E, i, all_of(dt) * load(E, i) + load(G, 6 * (left // WIDE) + i))
        _carry_panel(Z, E, 1.0 if constant else dt, f, C)


@njit(apart=True, cache=True, error_model="numpy", **UNCOUNTED)
def _tick_rows(X, Phid, diagonal, T, moving):
    """Rows from 9 on of X (panels) from the left by the transition of the drive's blocks; T (k * WIDE,): work."""
    k = moving - 9
    for begin in range(0, X.size, _high(moving) * WIDE):
        Z = X[begin + 9 * WIDE : begin + moving * WIDE]
        if diagonal:
            for i in range(k):
                c = Phid[i, i]
                if c != 1.0:
                    store(Z, i, load(Z, i) * all_of(c))
            continue
        for i in range(k):
            for j in range(WIDE):
                T[i * WIDE + j] = 0.0
            for s in range(k):
                c = Phid[i, s]
                if c != 0.0:
                    for j in range(WIDE):
                        T[i * WIDE + j] += c * Z[s * WIDE + j]
        for j in range(k * WIDE):
            Z[j] = T[j]


@njit(cache=True, error_model="numpy", **UNCOUNTED)
def _transpose(X, m):
    """Of a matrix in panels, as many as there are, in place."""
    size, square = _high(m) * WIDE, WIDE * WIDE
    for p in range(X.size // size):
        for q in range(p):
            # the elements below the diagonal stand in the rows of one panel, their mirror images in those of the other
            exchange(X, q * size + p * square, int(WIDE), X, p * size + q * square, int(WIDE))
        transpose(X, p * (size + square), int(WIDE), X, p * (size + square), int(WIDE))


@njit(apart=True, cache=True, error_model="numpy", **UNCOUNTED)
def _tick_drive(xd, Phid, Qd, diagonal, T, Q, moving):
    """A tick of the drive's blocks: their mean, and their noise into Q (panels)."""
    k = moving - 9
    if diagonal:
        for i in range(k):
            xd[i] *= Phid[i, i]
            if Qd[i, i] != 0.0:
                Q[_place(9 + i, 9 + i, moving)] += Qd[i, i]
        return
    for i in range(k):
        T[i] = 0.0
        for j in range(k):
            T[i] += Phid[i, j] * xd[j]
            if Qd[i, j] != 0.0:
                Q[_place(9 + i, 9 + j, moving)] += Qd[i, j]
    for i in range(k):
        xd[i] = T[i]


@njit(cache=True, error_model="numpy", inline="always", **UNCOUNTED)
def _inertial_compound(xd, Phid, Qd, ticking, ticks, C, seen, kinds, work, both, Q, gathered, moving):
    """Compound Phi <- F Phi, Q <- F Q F' with the step that `_inertial_advance` left in `work`; the drive's blocks
    tick, and their mean too.

    ticking: whether a tick is diagonal, and whether nothing but noise comes with it. both: panels of Phi and behind
    them Q, those of Q; gathered: whether there is any noise yet. Q F' is formed as (F Q)', Q being symmetric.
    """
    (diagonal, walks), T = ticking, work[work.size - WIDE * len(xd) :]
    Phi_ends = both.size - Q.size
    moved = both if gathered else both[:Phi_ends]
    _inertial_carry(moved, work, C, seen, kinds, moving, Phi_ends)
    if ticks > 0 and not walks:
        _tick_rows(moved, Phid, diagonal, T, moving)
    if gathered:
        _transpose(Q, moving)
        _inertial_carry(Q, work, C, seen, kinds, moving, int(0))
    for count in range(ticks):
        if count > 0 and not walks:
            _tick_rows(both, Phid, diagonal, T, moving)
            _transpose(Q, moving)
        if (gathered or count > 0) and not walks:
            _tick_rows(Q, Phid, diagonal, T, moving)
        if walks:
            for i in range(moving - 9):
                Q[_place(9 + i, 9 + i, moving)] += Qd[i, i]
        else:
            _tick_drive(xd, Phid, Qd, diagonal, T, Q, moving)


@njit(cache=True, error_model="numpy", inline="always", **UNCOUNTED)
def _add_both(Q, i, j, value, m):
    """Add to an element of the panels of a symmetric matrix of m rows, and to the one across."""
    Q[_place(i, j, m)] += value
    if i != j:
        Q[_place(j, i, m)] += value


@njit(apart=True, cache=True, error_model="numpy", **UNCOUNTED)
def _inertial_noise(dt, drv, Cr, Q, moving):
    """White noise of one step, into the panels of Q: variance r per sample means an angle (velocity) variance r *
    period per second.
    """
    C, k = drv[MEAN_C : MEAN_C + 9], Cr.shape[1] - 1
    period = drv[PERIOD_S] * max(dt, 0.0)
    a0, a1, a2 = Cr[0, k] * period, Cr[1, k] * period, Cr[2, k] * period
    v0, v1, v2 = Cr[3, k] * period, Cr[4, k] * period, Cr[5, k] * period
    gap = dt > GAP_PERIODS * drv[PERIOD_S]
    if gap:
        # about x and y a vehicle comes back to where it was: what it tilts by is bounded, what it turns by is not
        turned, unseen = drv[GAP_RATE_SD] * dt, (drv[GAP_FORCE_SD] * dt) ** 2
        tilted = min(turned, GAP_TILT) ** 2
        a0, a1, a2 = a0 + tilted, a1 + tilted, a2 + turned * turned
        v0, v1, v2 = v0 + unseen, v1 + unseen, v2 + unseen
    for i in range(3):
        x, y, z = C[3 * i], C[3 * i + 1], C[3 * i + 2]
        for j in range(i + 1):
            xx, yy, zz = x * C[3 * j], y * C[3 * j + 1], z * C[3 * j + 2]
            angle, speed = xx * a0 + yy * a1 + zz * a2, xx * v0 + yy * v1 + zz * v2
            _add_both(Q, 6 + i, 6 + j, angle, moving)
            _add_both(Q, 3 + i, 3 + j, speed, moving)
            if gap:
                way = speed * 0.5 * dt
                _add_both(Q, i, j, speed * 0.25 * dt * dt, moving)
                _add_both(Q, 3 + i, j, way, moving)
                if i != j:
                    _add_both(Q, 3 + j, i, way, moving)


@njit(apart=True, cache=True, error_model="numpy", **UNCOUNTED)
def _uncalibrated(dt, drv, seen, begin, end, varying, work):
    """Take the calibration errors off the increments, and note how each element of M enters, by what its axis reads: as
    one of the pairs from begin to end if these vary (by a rate, which over no time at all is no number, and nothing to
    speak of), as a constant by what it does in this step.
    """
    inc, readings, gain, M = work[:STEP], work[STEP : STEP + 6], work[GAINS:], drv[CALIBRATION : CALIBRATION + 18]
    G = gain[seen.shape[1] :]
    for c in (0, 3):
        x, y, z = inc[c], inc[c + 1], inc[c + 2]
        for i in range(3):
            of = 3 * (c + i)
            readings[c + i] = inc[c + i]
            inc[c + i] = inc[c + i] - M[of] * x - M[of + 1] * y - M[of + 2] * z
    for p in range(begin, end):
        if varying:
            gain[p] = readings[seen[2, p]] / dt if dt != 0.0 else 0.0
        else:
            G[seen[3, p]] = readings[seen[2, p]]


@njit(cache=True, error_model="numpy", **UNCOUNTED)
def _note_calibration(xd, drv):
    """Write down what all elements of M are thought to be."""
    elements = int(drv[CALIBRATED])
    for i in range(18 if elements > 0 else 0):
        drv[CALIBRATION + i] = 0.0
    for q in range(elements):
        drv[CALIBRATION + int(drv[ELEMENTS + q])] = xd[len(xd) - elements + q]


@njit(apart=True, cache=True, error_model="numpy", **UNCOUNTED)
def _constants(Phid, Qd, drv):
    """How many of the drive's last states never change by themselves: all elements of M, or none."""
    elements = int(drv[CALIBRATED])
    for i in range(Phid.shape[0] - elements, Phid.shape[0]):
        if Phid[i, i] != 1.0 or Qd[i, i] != 0.0:
            return 0
    return elements


@njit(apart=True, cache=True, error_model="numpy", **UNCOUNTED)
def _which_errors(Cr, drv, constants, seen, gain):
    """Which of the six readings (row 0 of seen) which of the drive's states (row 1) enters, and by how much (gain):
    first the states of its error models, then the elements of M, whose gains follow from the readings (of the axis in
    row 2; row 3: where in six rows to a panel they stand).

    Returns how many such pairs there are, how many of the first, whether these are plain, one state a reading, in their
    order, as it is, and how many pairs are of states that are no constants.
    """
    elements = int(drv[CALIBRATED])
    count, plain = 0, True
    for i in range(6):
        for s in range(Cr.shape[1] - 1 - elements):
            if Cr[i, s] != 0.0:
                seen[0, count], seen[1, count], gain[count] = i, s, Cr[i, s]
                plain = plain and i == s == count and gain[count] == 1.0
                count += 1
    noisy = count
    for q in range(elements):
        element, state = int(drv[ELEMENTS + q]), Cr.shape[1] - 1 - elements + q
        reading, column = OF_READING[element], 9 + state
        seen[0, count], seen[1, count], seen[2, count] = reading, state, BY_AXIS[element]
        seen[3, count] = (6 * (column // WIDE) + reading) * WIDE + column % WIDE
        gain[count] = 0.0
        count += 1
    return count, noisy, plain and noisy == 6, count - constants


@njit(cache=True, error_model="numpy", **UNCOUNTED)
def _is_diagonal(A, k):
    for i in range(k):
        for j in range(k):
            if i != j and A[i, j] != 0.0:
                return False
    return True


@njit(apart=True, cache=True, error_model="numpy", **UNCOUNTED)
def _to_panels(M, X, m, moving):
    """Fill panels X with the rows of the states that move, of a matrix of m columns at the beginning of M, which is
    longer.
    """
    high = _high(moving)
    for column in range(0, X.size // high, WIDE):
        begin, known = column * high, float(m - column)
        for i in range(moving):
            row = eight(M, i * m + column)
            put(X, begin + i * WIDE, if_below(eight(COLUMNS, 0), all_of(known), row, all_of(0.0)))
        for i in range(moving, high):
            put(X, begin + i * WIDE, all_of(0.0))


@njit(apart=True, cache=True, error_model="numpy", **UNCOUNTED)
def _from_panels(X, M, m, moving):
    """The way back. What it writes too much is overwritten by the next row; behind the last row M is work space, or
    begins the row of a constant, with zeros.
    """
    high = _high(moving)
    for i in range(moving):
        for column in range(0, X.size // high, WIDE):
            put(M, i * m + column, eight(X, column * high + i * WIDE))


@njit(cache=True, error_model="numpy", **UNCOUNTED)
def _ticks(span, drv):
    """How often the drive's blocks tick over a step: once per sample, those that are missing included."""
    return int(min(max(span / drv[PERIOD_S] + 0.5, 1.0), MOST_TICKS))


@njit(cache=True, error_model="numpy", **UNCOUNTED)
def _finish(xd, Phid, Qd, ticks, acc):
    """Complete the transition with the drive's blocks, compound it, and tick the blocks (their mean too)."""
    k = len(xd)
    m = 9 + k
    F, Q, W = acc[2 * m : 3 * m], acc[m : 2 * m], acc[3 * m :]
    for i in range(k):
        for j in range(k):
            F[9 + i, 9 + j] = Phid[i, j] if ticks > 0 else (1.0 if i == j else 0.0)
    _compound(acc, m)
    for count in range(ticks):
        if count == 1:
            _clear_transition(F, m)
            for i in range(9):
                F[i, i] = 1.0
            for i in range(k):
                for j in range(k):
                    F[9 + i, 9 + j] = Phid[i, j]
        if count > 0:
            _compound(acc, m)
        for i in range(k):
            W[0, i] = 0.0
            for j in range(k):
                W[0, i] += Phid[i, j] * xd[j]
                Q[9 + i, 9 + j] += Qd[i, j]
        for i in range(k):
            xd[i] = W[0, i]


@njit(cache=True, error_model="numpy", **UNCOUNTED)
def _high(m):
    """Rows of a panel of a matrix of m rows: blocks of as many rows as columns can be transposed, and there are the six
    behind navigation that a carry reads.
    """
    return (m + WIDE - 1) // WIDE * WIDE


@njit(cache=True, error_model="numpy", **UNCOUNTED)
def _place(i, j, m):
    """Where an element stands in the panels of a matrix of m rows."""
    return (j // WIDE * _high(m) + i) * WIDE + j % WIDE


@njit(cache=True, error_model="numpy", **UNCOUNTED)
def _room(m):
    """Elements of the work space of the inertial kernels for a head of m states."""
    return WIDE + 2 * _high(m) * _high(m) + GAINS + 6 * (m - 9) + 6 * _high(m) + WIDE * (m - 9)


@njit(apart=True, cache=True, error_model="numpy", **UNCOUNTED)
def _workspace(floats, m, moving):
    """Its parts: panels of Phi and Q, from where a line of the cache begins, for their rows are as long as lines; those
    of Q; and work, see `GAINS`.
    """
    begin, high = -(floats.ctypes.data // 8) % WIDE, _high(moving)
    Q = begin + high * _high(m)
    end = Q + high * high
    return floats[begin:end], floats[Q:end], floats[end : end + GAINS + 6 * _high(m) + (6 + WIDE) * (m - 9)]


@njit(cache=True, error_model="numpy")
def imu_steps(nav, xd, drv, samples, Phid, Qd, Cr, acc):
    """Strapdown over a block of samples (rates or increments) with coning and sculling by the linear-rate assumption.

    Increments already used by `imu_hold` since the previous sample are taken off, so that holds change when the state
    is known, not what it becomes. Savage (1998), parts 1 and 2; Groves (2013), ch. 5.
    """
    floats, seen = flat(scratch(np.float64, int(1), _room(9 + len(xd)))), scratch(np.int64, int(4), 6 * len(xd))
    _imu_steps(nav, xd, drv, samples, Phid, Qd, Cr, acc, floats, seen, samples[:0])


@njit(cache=True, error_model="numpy")
def imu_traced(nav, xd, drv, samples, Phid, Qd, Cr, acc, trace):
    """`imu_steps` that leaves in the rows of `trace`, if it has any, what each sample leaves: nav, xd, Phi and Q, and
    WIDE elements of work space.
    """
    floats, seen = flat(scratch(np.float64, int(1), _room(9 + len(xd)))), scratch(np.int64, int(4), 6 * len(xd))
    _imu_steps(nav, xd, drv, samples, Phid, Qd, Cr, acc, floats, seen, trace)


@njit(cache=True, error_model="numpy", inline="always", **UNCOUNTED)
def _begin(Phid, Qd, Cr, drv, acc, both, Q, seen, gain, moving):
    """Lay out what is compounded; which errors there are, how blocks tick, and whether there is any noise yet. Only
    rows of states that move: constants gather no noise.
    """
    m, rows = acc.shape[1], flat(acc)
    kinds = _which_errors(Cr, drv, m - moving, seen, gain)
    _to_panels(rows, both[: both.size - Q.size], m, moving)
    _to_panels(rows[m * m :], Q, m, moving)
    gathered = 0  # a variance of 0 has covariances of 0
    for i in range(moving):
        gathered += acc[m + i, i] != 0.0
    for i in range(6 * _high(m) if moving < m else 0):
        gain[seen.shape[1] + i] = 0.0
    diagonal, ones = _is_diagonal(Phid, moving - 9) and _is_diagonal(Qd, moving - 9), 0
    for i in range(moving - 9):
        ones += Phid[i, i] == 1.0
    return kinds, (diagonal, diagonal and ones == moving - 9), gathered > 0


@njit(cache=True, error_model="numpy", **UNCOUNTED)
def _trace(nav, xd, row):
    for i in range(17):
        row[i] = nav[i]
    for i in range(len(xd)):
        row[17 + i] = xd[i]


@njit(apart=True, cache=True, error_model="numpy", **UNCOUNTED)
def _trace_panels(nav, xd, acc, both, Q, moving, trace, n):
    """What a sample leaves, into row n; rows of constants, and their columns of Q, are those of acc."""
    row, m = trace[n], acc.shape[1]
    _trace(nav, xd, row)
    if moving < m:
        before = flat(acc)
        for i in range(2 * m * m):
            row[8 + m + i] = before[i]
    _from_panels(both[: both.size - Q.size], row[8 + m :], m, moving)
    _from_panels(Q, row[8 + m + m * m :], m, moving)


@njit(apart=True, cache=True, error_model="numpy", **UNCOUNTED)
def _imu_steps(nav, xd, drv, samples, Phid, Qd, Cr, acc, floats, seen, trace):
    m = 9 + len(xd)
    moving = m - _constants(Phid, Qd, drv)
    both, Q, work = _workspace(floats, m, moving)
    kinds, ticking, gathered = _begin(Phid, Qd, Cr, drv, acc, both, Q, seen, work[GAINS:], moving)
    _note_calibration(xd, drv)
    C, inc = drv[MEAN_C : MEAN_C + 9], work[:STEP]
    for n in range(samples.shape[0]):
        _increments(samples, n, drv, inc)
        drv[COUNT] += 1.0
        for i in range(6):
            drv[SUMS + i] += samples[n, 1 + i]
            drv[SQUARES + i] += samples[n, 1 + i] * samples[n, 1 + i]
        dt = samples[n, 0] - drv[HELD_S]
        drv[HELD_S] = 0.0
        if drv[CALIBRATED] != 0.0:
            if kinds[3] == kinds[0]:  # they are no constants
                _note_calibration(xd, drv)
            _uncalibrated(dt, drv, seen, kinds[1], kinds[0], kinds[3] == kinds[0], work)
        _take_errors_off(inc, xd, dt, seen, kinds, work[GAINS:])
        _inertial_advance(nav, dt, drv, work)
        ticks = _ticks(samples[n, 0], drv)
        _inertial_compound(xd, Phid, Qd, ticking, ticks, C, seen, kinds, work, both, Q, gathered, moving)
        _inertial_noise(dt, drv, Cr, Q, moving)
        gathered = True
        # all samples or none; of a condition that stays the same the compiler made two loops, a tenth slower
        if n < trace.shape[0]:
            _trace_panels(nav, xd, acc, both, Q, moving, trace, n)
    _from_panels(both[: both.size - Q.size], flat(acc), m, moving)
    _from_panels(Q, flat(acc[m:]), m, moving)


@njit(cache=True, error_model="numpy")
def imu_hold(nav, xd, drv, dt, Phid, Qd, Cr, acc):
    """Carry the state `dt` seconds past the last sample with that sample's rates; the blocks do not tick."""
    floats, seen = flat(scratch(np.float64, int(1), _room(9 + len(xd)))), scratch(np.int64, int(4), 6 * len(xd))
    _imu_hold(nav, xd, drv, dt, Phid, Qd, Cr, acc, floats, seen)


@njit(apart=True, cache=True, error_model="numpy", **UNCOUNTED)
def _imu_hold(nav, xd, drv, dt, Phid, Qd, Cr, acc, floats, seen):
    m = 9 + len(xd)
    moving = m - _constants(Phid, Qd, drv)
    both, Q, work = _workspace(floats, m, moving)
    kinds, ticking, gathered = _begin(Phid, Qd, Cr, drv, acc, both, Q, seen, work[GAINS:], moving)
    _note_calibration(xd, drv)
    C, inc = drv[MEAN_C : MEAN_C + 9], work[:STEP]
    scale = dt / drv[PERIOD_S] if drv[INCREMENTS] != 0.0 else dt
    for i in range(6):
        inc[i] = drv[PREVIOUS + i] * scale
        drv[CONSUMED + i] += inc[i]
    drv[HELD_S] += dt
    if drv[CALIBRATED] != 0.0:
        _uncalibrated(dt, drv, seen, kinds[1], kinds[0], kinds[3] == kinds[0], work)
    _take_errors_off(inc, xd, dt, seen, kinds, work[GAINS:])
    _inertial_advance(nav, dt, drv, work)
    _inertial_compound(xd, Phid, Qd, ticking, int(0), C, seen, kinds, work, both, Q, gathered, moving)
    _inertial_noise(dt, drv, Cr, Q, moving)
    _from_panels(both[: both.size - Q.size], flat(acc), m, moving)
    _from_panels(Q, flat(acc[m:]), m, moving)


@njit(cache=True, error_model="numpy", **UNCOUNTED)
def _move(nav, dn, de, dd):
    """Move the nominal position by metres in n."""
    dlat = dn / nav[15]
    nav[1] += de / (nav[16] * math.cos(nav[0] + 0.5 * dlat))
    nav[0] += dlat
    nav[2] -= dd
    rn, re = radii(nav[0])
    nav[15], nav[16] = rn + nav[2], re + nav[2]


@njit(cache=True, error_model="numpy", **UNCOUNTED)
def _position_rows(nav, F, dt, m):
    """Add what the curved Earth does to a position error carried `dt` with the present velocity (small terms)."""
    tl = math.tan(nav[0])
    F[0, 0] -= dt * nav[5] / nav[15]
    F[0, 2] += dt * nav[3] / nav[15]
    F[1, 0] += dt * nav[4] * tl / nav[15]
    F[1, 1] -= dt * (nav[5] / nav[16] + tl * nav[3] / nav[15])
    F[1, 2] += dt * nav[4] / nav[16]


@njit(cache=True, error_model="numpy", **UNCOUNTED)
def _deviated(reading, sin1, cos1, sin2, cos2):
    """Deviation of a compass that reads this beside its other errors, and by how much of an error of the reading the
    heading errs: deviation is told by the heading, and not by what is read there.

    Where seven degrees of it turn with the heading, to take it at the reading was an error of half a degree.
    """
    heading, slope = reading, 0.0
    for _ in range(3):  # of Newton: what is left of a radian in ten is 1e-8
        s1, c1 = math.sin(heading), math.cos(heading)
        s2, c2 = 2.0 * s1 * c1, c1 * c1 - s1 * s1
        slope = max(sin1 * c1 - cos1 * s1 + 2.0 * (sin2 * c2 - cos2 * s2), -0.5)
        heading -= (heading - reading + sin1 * s1 + cos1 * c1 + sin2 * s2 + cos2 * c2) / (1.0 + slope)
    return reading - heading, 1.0 / (1.0 + slope)


@njit(cache=True, error_model="numpy", **UNCOUNTED)
def _steady(drv, samples, n, blind, missing):
    """Have the readings by which slopes are made follow those of a sample, see `consistency.limit_velocity_slopes`.

    What a reading errs by is in the state, too: in velocity and heading, and by these in the position. Were it in the
    slope by a constant as well, each fix that shows it would tell the constant, always to the same side: errors in
    variables (Fuller, 1987, sec. 1.1). A lever arm was drawn to nothing by a heading that errs, for arms of nothing
    would not turn. So slopes are those of a reading that stays where it is for as long as errors may be all that
    changes.
    """
    for i in range(6):
        if blind if i < 3 else missing:
            continue
        step = samples[n, 1 + i] - drv[STEADY + i]
        if i < 3:
            step -= 2.0 * math.pi * math.floor(step / (2.0 * math.pi) + 0.5)
        near = drv[STARTED] != 0.0 and abs(step) <= STEADY_SDS * drv[SPREAD + i]
        drv[STEADY + i] += FOLLOWED * step if near else step


@njit(cache=True, error_model="numpy", **UNCOUNTED)
def _attitude(roll, pitch, yaw, C):
    """C_nb of these angles, row by row; returns cosine and sine of the last."""
    cr, sr, cp, sp = math.cos(roll), math.sin(roll), math.cos(pitch), math.sin(pitch)
    cy, sy = math.cos(yaw), math.sin(yaw)
    C[0], C[1], C[2] = cp * cy, sr * sp * cy - cr * sy, cr * sp * cy + sr * sy
    C[3], C[4], C[5] = cp * sy, sr * sp * sy + cr * cy, cr * sp * sy - sr * cy
    C[6], C[7], C[8] = -sp, sr * cp, cr * cp
    return cy, sy


@njit(cache=True, error_model="numpy", **UNCOUNTED)
def _steady_attitude(drv):
    """The attitude that slopes see, into drv; how it has turned is there before."""
    yaw = drv[STEADY + 2] + drv[DECLINATION]
    _attitude(drv[STEADY], drv[STEADY + 1], yaw, drv[STEADY_C : STEADY_C + 9])


@njit(cache=True, error_model="numpy", **UNCOUNTED)
def _arm_columns(F, drv, C, B, missing, half, arm, told, spin, turn):
    """What an error of the lever arm does to velocity and position of a step, and in drv the turn for the next one.

    The position has moved as the attitude that slopes see has turned, see `_steady`; the velocity, of which no sum is
    taken, turns as it is read, by the share `told` that stands out of the noise. turn (9,): work.

    A velocity that is missing was that of the last step, which its turn had moved by the arm (B turns it on).
    """
    for i in range(9):
        turn[i] = drv[STEADY_C + i]
    _steady_attitude(drv)
    for i in range(3):
        drv[ARM_TURN + 3 * i] = C[i, 1] * spin[2] - C[i, 2] * spin[1]
        drv[ARM_TURN + 3 * i + 1] = C[i, 2] * spin[0] - C[i, 0] * spin[2]
        drv[ARM_TURN + 3 * i + 2] = C[i, 0] * spin[1] - C[i, 1] * spin[0]
    for j in range(3):
        for i in range(3):
            before, turned = 0.0, told * drv[ARM_TURN + 3 * i + j]
            if missing:
                for r in range(3):
                    before += B[i, r] * drv[STEADY_TURN + 3 * r + j]
            F[3 + i, 9 + arm + j] += before - turned
            F[i, 9 + arm + j] += half * (before + drv[STEADY_TURN + 3 * i + j])
            F[i, 9 + arm + j] -= drv[STEADY_C + 3 * i + j] - turn[3 * i + j] if drv[STARTED] != 0.0 else 0.0
    for i in range(3):
        for j in range(3):
            drv[STEADY_TURN + 3 * i + j] = told * drv[ARM_TURN + 3 * i + j]


@njit(cache=True, error_model="numpy", **UNCOUNTED)
def _change(drv, now, before, span, missing, Cr, wander, late):
    """How fast readings (6,) change [unit/s], in drv: the difference from those before, a little smoothed; 0
    over gaps and while the velocity is lost. late (6,): as far as that stands out of what the noise of the readings
    changes by, which is white (last column of Cr) and wanders by so much from one to the next, wander (6,).
    """
    near = drv[STARTED] != 0.0 and 0.0 < span <= GAP_PERIODS * drv[PERIOD_S]
    for i in range(6):
        step = now[i] - before[i]
        if i < 3:
            step -= 2.0 * math.pi * math.floor(step / (2.0 * math.pi) + 0.5)
            known = near
        else:
            known = near and not missing and drv[KNOWN_VELOCITY] != 0.0
        late[i] = 0.0
        if not known:
            drv[CHANGE + i] = 0.0
            continue
        white, walk = 2.0 * Cr[i, Cr.shape[1] - 1] / (span * span), wander[i] / (span * span)
        step = step / span - drv[CHANGE + i]
        share = span / (span + (CHANGE_S if step * step > SUDDEN**2 * (white + walk) else STEADY_S))
        drv[CHANGE + i] += share * step
        share = span / (span + STEADY_S)
        noise = share / (2.0 - share) * (TOLD_CHANGE**2 * share * white + TOLD_WANDER**2 * walk)
        square = drv[CHANGE + i] ** 2
        late[i] = drv[CHANGE + i] * square / (square + noise) if square > 0.0 else 0.0


@njit(cache=True, error_model="numpy")
def _stuck(drv, samples, n):
    """Whether attitude, the heading alone, and velocity have been the same for so long that nobody reads them."""
    # of a vehicle that is told to be level the heading alone is read, and a coarse one may stand still
    same_a = drv[STARTED] != 0.0 and (samples[n, 1] != 0.0 or samples[n, 2] != 0.0)
    same_v = drv[STARTED] != 0.0
    for i in range(3):
        same_a = same_a and samples[n, 1 + i] == drv[PREVIOUS_RPY + i]
        same_v = same_v and samples[n, 4 + i] == drv[PREVIOUS_VELOCITY_B + i] and samples[n, 4 + i] != 0.0
        drv[PREVIOUS_VELOCITY_B + i] = samples[n, 4 + i]
    drv[SAME_ATTITUDE_S] = drv[SAME_ATTITUDE_S] + samples[n, 0] if same_a else 0.0
    drv[SAME_VELOCITY_S] = drv[SAME_VELOCITY_S] + samples[n, 0] if same_v else 0.0
    most_s = max(STUCK_S, STUCK_PERIODS * drv[PERIOD_S])
    same_h = drv[STARTED] != 0.0 and samples[n, 3] == drv[PREVIOUS_RPY + 2]
    drv[SAME_HEADING_S] = drv[SAME_HEADING_S] + samples[n, 0] if same_h else 0.0
    if drv[SAME_HEADING_S] <= COUNTED_PERIODS * drv[PERIOD_S]:  # a long run says no more than a short one
        drv[SEEN] = min(drv[SEEN] + 1.0, REPEATS_SAMPLES)
        drv[REPEATS] += ((1.0 if same_h else 0.0) - drv[REPEATS]) / drv[SEEN]
    stuck_a, stuck_h = drv[SAME_ATTITUDE_S] > most_s, drv[SAME_HEADING_S] > most_s
    stuck_h = stuck_h and drv[REPEATS] < OFTEN and drv[SEEN] >= KNOWN_SAMPLES
    if stuck_h:
        drv[SAME_ATTITUDE_S] = drv[SAME_HEADING_S]
    return stuck_a, stuck_h, drv[SAME_VELOCITY_S] > most_s


@njit(cache=True, error_model="numpy", **UNCOUNTED)
def has_jumped(drv):
    """Whether heading or velocity of dead reckoning have jumped, and nobody has heeded it."""
    found = False
    for i in range(JUMPED, JUMPED + 4):
        found = found or drv[i] != 0.0
    return found


@njit(cache=True, error_model="numpy", **UNCOUNTED)
def until_odd(drv, samples):
    """How many samples of dead reckoning may be taken before it has to be looked whether they have jumped."""
    n = 0
    while n < samples.shape[0]:
        last, calm = n - 1, drv[ODD_HEADING] == 0.0 and drv[ODD_VELOCITY] == 0.0
        angle = samples[n, 3] - (samples[last, 3] if n else drv[PREVIOUS_RPY + 2])
        angle -= 2.0 * math.pi * math.floor(angle / (2.0 * math.pi) + 0.5)
        calm, moving = calm and abs(angle) <= SCATTER_RAD, drv[ZERO_IS_VALID] != 0.0
        for i in range(3):
            v = samples[n, 4 + i]
            moving = moving or v != 0.0
            calm = calm and abs(v - (samples[last, 4 + i] if n else drv[GOOD_VELOCITY + i])) <= SCATTER_M_S
        n += 1
        if not (calm and moving):
            break
    return n


@njit(cache=True, error_model="numpy")
def _odd(drv, samples, n, blind, missing):
    """Whether heading and velocity are single ones that no vehicle can make of the last that were taken."""
    odd_a, odd_v = False, False
    if drv[STARTED] != 0.0 and not blind:
        angle = samples[n, 3] - drv[PREVIOUS_RPY + 2]
        angle -= 2.0 * math.pi * math.floor(angle / (2.0 * math.pi) + 0.5)
        odd_a = abs(angle) > MOST_TURN * (drv[BLIND_S] + samples[n, 0]) + SCATTER_RAD
        drv[ODD_HEADING] = drv[ODD_HEADING] + 1.0 if odd_a else 0.0
        if drv[ODD_HEADING] >= MOST_ODD:  # it stays there
            drv[JUMPED], drv[PREVIOUS_RPY + 2], drv[ODD_HEADING] = angle, samples[n, 3], 0.0
    drv[GOOD_S] = drv[GOOD_S] + samples[n, 0] if drv[GOOD_S] >= 0.0 else -1.0
    if not missing:
        most = MOST_ACCELERATION * drv[GOOD_S] + SCATTER_M_S
        for i in range(3):
            odd_v = odd_v or (drv[GOOD_S] >= 0.0 and abs(samples[n, 4 + i] - drv[GOOD_VELOCITY + i]) > most)
        drv[ODD_VELOCITY] = drv[ODD_VELOCITY] + 1.0 if odd_v else 0.0
        stays = drv[ODD_VELOCITY] >= MOST_ODD
        if stays:
            drv[ODD_VELOCITY] = 0.0
            for i in range(3):
                drv[JUMPED + 1 + i] = samples[n, 4 + i] - drv[GOOD_VELOCITY + i]
        if stays or not odd_v:
            drv[GOOD_S] = 0.0
            for i in range(3):
                drv[GOOD_VELOCITY + i] = samples[n, 4 + i]
    return odd_a, odd_v


@njit(cache=True, error_model="numpy", **UNCOUNTED)
def _bend(drv, C, v0, v1, v2, by):
    """Note in drv by how much the trapezoidal rule is ahead of the way: by a twelfth of the square of the step, `by`,
    times the acceleration now, less that at the start (Euler and Maclaurin). v: velocity in n that turns.

    Dives of 35 deg at 1 Hz were ahead by a centimetre while they began: in the clock of the attitude, 0.04 s.
    """
    x = C[0, 0] * v0 + C[1, 0] * v1 + C[2, 0] * v2
    y = C[0, 1] * v0 + C[1, 1] * v1 + C[2, 1] * v2
    z = C[0, 2] * v0 + C[1, 2] * v1 + C[2, 2] * v2
    a = drv[TURNING + 1] * z - drv[TURNING + 2] * y + drv[GAINING]
    b = drv[TURNING + 2] * x - drv[TURNING] * z + drv[GAINING + 1]
    c = drv[TURNING] * y - drv[TURNING + 1] * x + drv[GAINING + 2]
    for i in range(3):
        drv[BENT + i] = by * (C[i, 0] * a + C[i, 1] * b + C[i, 2] * c)


@njit(cache=True, error_model="numpy", **UNCOUNTED)
def _shaken_arm(Q, J, X, drv, C, per, half, arm, roll, pitch, Cr, wander):
    """What noise of a turn, the difference of two attitudes, does to the velocity of the arm (3,) in b, and that it is
    the turn of the middle of the step. X (6, 3): work.

    The next position goes on from the velocity of the instrument, which is not shaken: so that nothing of it stays, the
    position errs by half a step of it to the other side until then.
    """
    k = Cr.shape[1] - 1
    e0, e1, e2 = arm[0], arm[1], arm[2]
    sr, cr, sp, cp = math.sin(roll), math.cos(roll), math.sin(pitch), math.cos(pitch)
    for j in range(3):
        # the axis of each angle in b, and the arm it takes along
        a = 1.0 if j == 0 else 0.0 if j == 1 else -sp
        b = 0.0 if j == 0 else cr if j == 1 else sr * cp
        c = 0.0 if j == 0 else -sr if j == 1 else cr * cp
        y0, y1, y2 = b * e2 - c * e1, c * e0 - a * e2, a * e1 - b * e0
        for i in range(3):
            X[3 + i, j] = -per * (C[i, 0] * y0 + C[i, 1] * y1 + C[i, 2] * y2)
            X[i, j] = -half * X[3 + i, j]
    for i in range(6):
        for a in range(3):
            white = Cr[a, k]
            for j in range(6):
                Q[i, j] += X[i, a] * (2.0 * white + wander[a]) * X[j, a]
            for j in range(9):  # that of the second attitude is in the state, too
                Q[i, j] += X[i, a] * white * J[j, a]
                Q[j, i] += X[i, a] * white * J[j, a]
    # half of what the turn changes by from step to step, about an axis that is not noted: half of its square for each
    unseen = 0.5 * 0.25 * drv[TURN_USUAL]
    for j in range(3):
        y0, y1, y2 = (0.0, -e2, e1) if j == 0 else (e2, 0.0, -e0) if j == 1 else (-e1, e0, 0.0)
        for i in range(3):
            X[3 + i, 0] = -(C[i, 0] * y0 + C[i, 1] * y1 + C[i, 2] * y2)
            X[i, 0] = -half * X[3 + i, 0]
        for i in range(6):
            for a in range(6):
                Q[i, a] += X[i, 0] * unseen * X[a, 0]


@njit(cache=True, error_model="numpy")
def _keep_attitude(F, l1, u0, u1, u2, half):
    """An attitude that was not read is that of the step before: its error turns the velocity u and the arm l1."""
    for j in range(3):
        a, b, c = 1.0 if j == 0 else 0.0, 1.0 if j == 1 else 0.0, 1.0 if j == 2 else 0.0
        y0, y1, y2 = b * l1[2] - c * l1[1], c * l1[0] - a * l1[2], a * l1[1] - b * l1[0]
        v0, v1, v2 = b * u2 - c * u1, c * u0 - a * u2, a * u1 - b * u0
        F[0, 6 + j] += half * v0 - y0
        F[1, 6 + j] += half * v1 - y1
        F[2, 6 + j] += half * v2 - y2
        F[3, 6 + j] += v0
        F[4, 6 + j] += v1
        F[5, 6 + j] += v2
        F[6 + j, 6 + j] += 1.0


@njit(cache=True, error_model="numpy")
def _keep_heading(F, l1, u0, u1, w, half, nav):
    """The same of a heading alone that was not read: by its derivative by the attitude of the step before."""
    n0, n1, n2 = nav[6], nav[9], nav[12]
    level = n0 * n0 + n1 * n1
    for j in range(3):
        by = 1.0 if j == 2 else -n2 * (n0 if j == 0 else n1) / level
        F[0, 6 + j] += by * (l1[1] - half * u1)
        F[1, 6 + j] += by * (half * u0 - l1[0])
        F[3, 6 + j] += by * (w[1] - u1)
        F[4, 6 + j] += by * (u0 - w[0])
        F[8, 6 + j] += by


@njit(cache=True, error_model="numpy")
def _evenly(drv, place, change, usual, now, variance, span):
    """Note in drv how fast something changes, three numbers at `place`, by what it has changed by `now`, and how much
    that was another before, at `change`. It goes on as far as it stands out of its noise of this variance: the part of
    the square beyond that is unbiased. So is that of the mean square of the other, at `usual`.
    """
    square, other = 0.0, 0.0
    for i in range(3):
        square += now[i] * now[i]
        other += (now[i] - drv[place + 3 + i]) ** 2
        drv[place + 3 + i] = now[i]
    share = 1.0 - variance / square if square > variance else 0.0
    drv[change] = math.sqrt(other)
    # noise of the reading in the middle enters a second difference twice
    drv[usual] = max(0.0, drv[usual] + min(1.0, span / USUAL_S) * (other - 3.0 * variance - drv[usual]))
    for i in range(3):
        drv[place + i] = share * now[i]


@njit(apart=True, cache=True, error_model="numpy")
def _hold_on(nav, xd, drv, dt, F):
    """Go on evenly for `dt` seconds, or back: the vehicle turns, and its velocity in b changes, as between the last two
    samples. F: transition of errors, but for the drive's states.
    """
    m = F.shape[1]
    _clear_transition(F, m)
    for i in range(9):
        F[i, i] = 1.0
    x, y, z = dt * drv[TURNING], dt * drv[TURNING + 1], dt * drv[TURNING + 2]
    p, q = rodrigues(x * x + y * y + z * z)
    flow, half = int(drv[CURRENT]), 0.5 * dt
    north, east = (xd[flow], xd[flow + 1]) if flow >= 0 else (0.0, 0.0)
    # through the water, which does not turn
    v0, v1, v2 = nav[3] - north, nav[4] - east, nav[5]
    R, C, v = np.empty((3, 3)), np.empty((3, 3)), np.empty(3)
    for i in range(3):
        C[i, 0], C[i, 1], C[i, 2] = rotated(-p, q, x, y, z, nav[6 + 3 * i], nav[7 + 3 * i], nav[8 + 3 * i])
    for i in range(3):
        v[i] = dt * (C[i, 0] * drv[GAINING] + C[i, 1] * drv[GAINING + 1] + C[i, 2] * drv[GAINING + 2])
        for j in range(3):
            R[i, j] = C[i, 0] * nav[6 + 3 * j] + C[i, 1] * nav[7 + 3 * j] + C[i, 2] * nav[8 + 3 * j]
        v[i] += R[i, 0] * v0 + R[i, 1] * v1 + R[i, 2] * v2
    for i in range(3):
        for j in range(3):
            F[3 + i, 3 + j] = R[i, j]
            if flow >= 0 and j < 2:
                F[3 + i, 9 + flow + j] = (1.0 if i == j else 0.0) - R[i, j]
        # an error of the attitude turns both velocities
        F[3 + i, 6] = R[i, 1] * v2 - R[i, 2] * v1
        F[3 + i, 7] = R[i, 2] * v0 - R[i, 0] * v2
        F[3 + i, 8] = R[i, 0] * v1 - R[i, 1] * v0
    F[3, 7], F[3, 8] = F[3, 7] + v[2], F[3, 8] - v[1]
    F[4, 8], F[4, 6] = F[4, 8] + v[0], F[4, 6] - v[2]
    F[5, 6], F[5, 7] = F[5, 6] + v[1], F[5, 7] - v[0]
    bow = half * (1.0 + z * z / 12.0)  # the arc of an even turn: one way back is as long as several there
    for i in range(3):
        by = half if i == 2 else bow
        for j in range(3, 9):
            F[i, j] = by * F[3 + i, j]
        F[i, 3 + i] += by
        if flow >= 0:
            for j in range(2):
                same = 1.0 if i == j else 0.0
                F[i, 9 + flow + j] = dt * same - by * (same + R[i, j])
    _position_rows(nav, F, dt, m)
    _move(nav, bow * (v0 + v[0]) + dt * north, bow * (v1 + v[1]) + dt * east, half * (v2 + v[2]))
    nav[3], nav[4], nav[5] = v[0] + north, v[1] + east, v[2]
    for i in range(3):
        for j in range(3):
            nav[6 + 3 * i + j] = C[i, j]


@njit(apart=True, cache=True, error_model="numpy")
def dead_reckoning_steps(nav, xd, drv, samples, Phid, Qd, Cr, acc):
    """Attitude and body velocity carried forward: no inertial unit (Groves, 2013, sec. 6.2; the classical AUV filter).

    A sample is seconds since the previous one, roll, pitch, yaw [rad] and the velocity in instrument axes [m/s]; a
    velocity that is NaN, or not a reading by the sensor's own limits, is held in body axes with growing uncertainty. An
    attitude with a NaN is held, too, and its error goes on from the last one that was read.
    Position goes by the trapezoidal rule on the velocity of the instrument's point, less what that is ahead of a way
    that bends, and by the turn of the lever arm itself: no angular rate is needed for it. The velocity has to have one,
    that of the turn from reading to reading.
    """
    k = len(xd)
    m = 9 + k
    F, Q = acc[2 * m : 3 * m], acc[m : 2 * m]
    J, B, C, X, M = np.empty((9, 6)), np.empty((3, 3)), np.empty((3, 3)), np.empty((6, 3)), drv[MOUNTING : MOUNTING + 9]
    last, err, late, wander, turn = np.empty(6), np.empty(6), np.empty(6), np.zeros(6), np.empty(9)
    seen, gained, angles, spin = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    v, u, w, l0, l1 = np.empty(3), np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    for i in range(6):
        for s in range(k):
            if Cr[i, s] != 0.0:
                for j in range(k):
                    wander[i] += Cr[i, s] * Qd[s, j] * Cr[i, j]
    for n in range(samples.shape[0]):
        span = samples[n, 0]
        if drv[HELD_S] != 0.0:
            _hold_on(nav, xd, drv, -drv[HELD_S], F)
            _finish(xd, Phid, Qd, int(0), acc)
        drv[HELD_S] = 0.0
        # -- the sensors' own errors
        dev, par, step = int(drv[DEVIATION]), int(drv[SCALE]), int(drv[SCALE_STEP])
        late_a, late_v, arm = int(drv[ATTITUDE_CLOCK]), int(drv[VELOCITY_CLOCK]), int(drv[ARM])
        flow = int(drv[CURRENT])
        north, east = (xd[flow], xd[flow + 1]) if flow >= 0 else (0.0, 0.0)
        for i in range(6):
            err[i] = 0.0
            for s in range(k):
                err[i] += Cr[i, s] * xd[s]
        going = drv[GOOD_S] >= 0.0 and drv[LOST_S] == 0.0
        for i in range(3):
            gained[i] = samples[n, 4 + i] - drv[GOOD_VELOCITY + i]
        missing, moving = False, drv[ZERO_IS_VALID] != 0.0
        for i in range(4, 7):
            missing = missing or not abs(samples[n, i]) <= drv[MAX_SPEED]
            moving = moving or samples[n, i] != 0.0
        stuck_a, stuck_h, stuck_v = _stuck(drv, samples, n)
        missing = missing or not moving or stuck_v
        blind = stuck_a or not math.isfinite(samples[n, 1] + samples[n, 2] + samples[n, 3])
        odd_a, odd_v = _odd(drv, samples, n, blind, missing)
        blind, missing = blind or odd_a, missing or odd_v
        held = stuck_h and not blind  # roll and pitch are read
        # one that is found to be stuck has not been read since it was
        unread = drv[SAME_ATTITUDE_S] if (stuck_a or held) and drv[BLIND_S] == 0.0 else span
        drv[BLIND_S] = drv[BLIND_S] + span if blind or held else 0.0
        drv[LOST_S] = drv[LOST_S] + span if missing else 0.0
        if blind:
            for i in range(3):
                samples[n, 1 + i] = drv[PREVIOUS_RPY + i]
        per = 1.0 / span if drv[STARTED] != 0.0 and span > 0.0 else 0.0
        if not missing and going:
            for i in range(3):
                w[i] = per * (M[3 * i] * gained[0] + M[3 * i + 1] * gained[1] + M[3 * i + 2] * gained[2])
            noise = 0.0
            for i in range(3, 6):
                noise += 2.0 * Cr[i, k] + wander[i]
            _evenly(drv, GAINING, SPEED_CHANGE, SPEED_USUAL, w, per * per * noise, span)
        elif missing:
            for i in range(3):
                drv[GAINING + i] = 0.0
        _steady(drv, samples, n, blind, missing)
        if late_a >= 0 or late_v >= 0:
            for i in range(3):
                last[i], last[3 + i] = drv[PREVIOUS_RPY + i], drv[PREVIOUS_VELOCITY + i]
            _change(drv, samples[n, 1:7], last, span, missing, Cr, wander, late)
            # A sensor beside it sees the noise of this reading: were it in the slope, too, it would tell the clock,
            # always to the same side (by half a second of one that scatters by 2 cm/s). How it changed before has none.
            for i in range(3):
                seen[i], drv[SLOPES + i] = drv[SLOPES + i], late[3 + i]
            for i in range(0 if missing else 3):
                drv[PREVIOUS_VELOCITY + i] = samples[n, 4 + i]
            drv[KNOWN_VELOCITY] = 0.0 if missing else 1.0
        for i in range(3):
            if late_a >= 0:
                err[i] -= xd[late_a] * late[i]
            if late_v >= 0:
                err[3 + i] -= xd[late_v] * late[3 + i]
        yaw, bent, straight = samples[n, 3], 0.0, 1.0
        if dev >= 0:
            bent, straight = _deviated(yaw - err[2], xd[dev], xd[dev + 1], xd[dev + 2], xd[dev + 3])
            err[2] += bent
        roll, pitch, psi = samples[n, 1] - err[0], samples[n, 2] - err[1], yaw - err[2] + drv[DECLINATION]
        if held:
            psi = math.atan2(nav[9], nav[6])
        cy, sy = _attitude(roll, pitch, psi, flat(C))
        if blind:
            for i in range(3):
                for j in range(3):
                    C[i, j] = nav[6 + 3 * i + j]
        turned = 0.0
        for i in range(3):
            angle = samples[n, 1 + i] - drv[PREVIOUS_RPY + i]
            angles[i] = angle - 2.0 * math.pi * math.floor(angle / (2.0 * math.pi) + 0.5)
            turned += angles[i] ** 2
            drv[PREVIOUS_RPY + i] = samples[n, 1 + i]
        # -- lever arm before and after, and its velocity: what the turn of the attitude moved it by
        e0, e1, e2 = drv[LEVER], drv[LEVER + 1], drv[LEVER + 2]
        if arm >= 0:
            e0, e1, e2 = e0 + xd[arm], e1 + xd[arm + 1], e2 + xd[arm + 2]
            for i in range(3):
                row = ARM_TURN + 3 * i
                drv[LEVER_VELOCITY + i] = drv[row] * e0 + drv[row + 1] * e1 + drv[row + 2] * e2
        told = 0.0
        for i in range(3):
            spin[i] = 0.0
        if blind:
            for i in range(3):
                drv[TURNING + i] = 0.0
            drv[TURN_CHANGE] = drv[TURN_RATE]
        else:
            sin_r, cos_r = math.sin(samples[n, 1]), math.cos(samples[n, 1])
            sin_p, cos_p = math.sin(samples[n, 2]), math.cos(samples[n, 2])
            spin[0] = per * (angles[0] - angles[2] * sin_p)
            spin[1] = per * (angles[1] * cos_r + angles[2] * sin_r * cos_p)
            spin[2] = per * (angles[2] * cos_r * cos_p - angles[1] * sin_r)
            drv[TURN_RATE], noise = per * math.sqrt(turned), 0.0
            for i in range(3):
                noise += 2.0 * Cr[i, k] + wander[i]
            _evenly(drv, TURNING, TURN_CHANGE, TURN_USUAL, spin, per * per * noise, span)
            told = turned / (turned + TOLD_TURN**2 * noise) if turned > 0.0 else 0.0
        # the arm is taken along
        v[0], v[1], v[2] = spin[1] * e2 - spin[2] * e1, spin[2] * e0 - spin[0] * e2, spin[0] * e1 - spin[1] * e0
        for i in range(3):
            l1[i] = C[i, 0] * e0 + C[i, 1] * e1 + C[i, 2] * e2
            l0[i] = nav[6 + 3 * i] * e0 + nav[7 + 3 * i] * e1 + nav[8 + 3 * i] * e2
            w[i] = C[i, 0] * v[0] + C[i, 1] * v[1] + C[i, 2] * v[2]
            if drv[STARTED] == 0.0:
                l0[i] = l1[i] = 0.0  # the start's velocity is that of the reference point
        _clear_transition(F, m)
        for i in range(9):
            for j in range(6):
                J[i, j] = 0.0
        # -- velocity of the instrument's point in n, and how errors of the readings reach it
        if not blind:
            for i in range(3):
                J[6 + i, 0] = C[i, 0]
            J[6, 1], J[7, 1], J[8, 2] = -sy, cy, 0.0 if held else straight
        if missing:
            for i in range(3):
                for j in range(3):
                    B[i, j] = C[i, 0] * nav[6 + 3 * j] + C[i, 1] * nav[7 + 3 * j] + C[i, 2] * nav[8 + 3 * j]
            # what is held is the velocity through the water, if it is water
            v[0], v[1], v[2] = nav[3] - north, nav[4] - east, nav[5]
            for i in range(3):
                u[i] = 0.0
                for j in range(3):
                    u[i] += B[i, j] * (v[j] + drv[LEVER_VELOCITY + j])
                    F[3 + i, 3 + j] = B[i, j]
                F[3 + i, 6] = B[i, 1] * v[2] - B[i, 2] * v[1]
                F[3 + i, 7] = B[i, 2] * v[0] - B[i, 0] * v[2]
                F[3 + i, 8] = B[i, 0] * v[1] - B[i, 1] * v[0]
        else:
            g0, g1, g2, a, b, c = 1.0, 1.0, 1.0, 0.0, 0.0, 0.0
            if par >= 0:
                g0, g1, g2 = 1.0 + xd[par], 1.0 + xd[par + step], 1.0 + xd[par + 2 * step]
                a, b, c = xd[par + 2 * step + 1], xd[par + 2 * step + 2], xd[par + 2 * step + 3]
            p, q = rodrigues(a * a + b * b + c * c)
            for i in range(3):
                # row i of C M, then times the inverse of (1 + scale) R(misalignment)
                r0 = C[i, 0] * M[0] + C[i, 1] * M[3] + C[i, 2] * M[6]
                r1 = C[i, 0] * M[1] + C[i, 1] * M[4] + C[i, 2] * M[7]
                r2 = C[i, 0] * M[2] + C[i, 1] * M[5] + C[i, 2] * M[8]
                r0, r1, r2 = rotated(p, q, a, b, c, r0, r1, r2)
                J[3 + i, 3], J[3 + i, 4], J[3 + i, 5] = r0 / g0, r1 / g1, r2 / g2
            z0, z1, z2 = samples[n, 4] - err[3], samples[n, 5] - err[4], samples[n, 6] - err[5]
            for i in range(3):
                u[i] = J[3 + i, 3] * z0 + J[3 + i, 4] * z1 + J[3 + i, 5] * z2
        half = 0.5 * span
        for j in range(6):
            # an angle turns velocities and, later in time than l0, the arm
            a, b, c = J[6, j], J[7, j], J[8, j]
            y0, y1, y2 = b * l1[2] - c * l1[1], c * l1[0] - a * l1[2], a * l1[1] - b * l1[0]
            u0, u1, u2 = J[3, j] + b * u[2] - c * u[1], J[4, j] + c * u[0] - a * u[2], J[5, j] + a * u[1] - b * u[0]
            J[0, j], J[1, j], J[2, j] = half * u0 - y0, half * u1 - y1, half * u2 - y2
            J[3, j], J[4, j], J[5, j] = u0 - b * w[2] + c * w[1], u1 - c * w[0] + a * w[2], u2 - a * w[1] + b * w[0]
        through0, through1, through2 = u[0], u[1], u[2]  # against what it is measured
        u[0], u[1] = u[0] + north, u[1] + east
        for i in range(3):
            v[i] = u[i] - w[i]
        # -- transition
        for i in range(3):
            for j in range(9):
                F[i, j] = half * F[3 + i, j]
        for i in range(3):
            F[i, i] += 1.0
            F[i, 3 + i] += half
        w0, w1, w2 = drv[LEVER_VELOCITY], drv[LEVER_VELOCITY + 1], drv[LEVER_VELOCITY + 2]
        F[0, 7] += half * w2 + l0[2]
        F[0, 8] -= half * w1 + l0[1]
        F[1, 8] += half * w0 + l0[0]
        F[1, 6] -= half * w2 + l0[2]
        F[2, 6] += half * w1 + l0[1]
        F[2, 7] -= half * w0 + l0[0]
        if blind:
            _keep_attitude(F, l1, through0, through1, through2, half)
        if held:
            _keep_heading(F, l1, through0, through1, w, half, nav)
        for s in range(k):
            for i in range(9):
                for a in range(6):
                    F[i, 9 + s] -= J[i, a] * Cr[a, s]
        if dev >= 0:
            s1, c1 = math.sin(drv[STEADY + 2] - bent), math.cos(drv[STEADY + 2] - bent)
            s2, c2 = 2.0 * s1 * c1, c1 * c1 - s1 * s1
            for i in range(9):
                F[i, 9 + dev] -= J[i, 2] * s1
                F[i, 10 + dev] -= J[i, 2] * c1
                F[i, 11 + dev] -= J[i, 2] * s2
                F[i, 12 + dev] -= J[i, 2] * c2
        for i in range(9):
            for a in range(3):
                if late_a >= 0:
                    F[i, 9 + late_a] += J[i, a] * late[a]
                if late_v >= 0:
                    F[i, 9 + late_v] += J[i, 3 + a] * seen[a]
        if arm >= 0:
            _arm_columns(F, drv, C, B, missing, half, arm, told, spin, turn)
        else:
            _steady_attitude(drv)
        if flow >= 0:
            for i in range(3):
                for j in range(2):
                    a = (1.0 if i == j else 0.0) - (B[i, j] if missing else 0.0)
                    F[3 + i, 9 + flow + j] += a
                    F[i, 9 + flow + j] += half * a
        if par >= 0 and not missing:
            # reading = (1 + s) R(m) y: y is the true velocity in instrument axes, and slopes see it steadily
            for i in range(3):
                off = drv[STEADY + 3 + i] - samples[n, 4 + i]
                through0 += J[3, 3 + i] * off
                through1 += J[4, 3 + i] * off
                through2 += J[5, 3 + i] * off
            for i in range(3):
                err[i] = 0.0
                for j in range(3):
                    through = through0 if j == 0 else through1 if j == 1 else through2
                    err[i] += (C[j, 0] * M[i] + C[j, 1] * M[3 + i] + C[j, 2] * M[6 + i]) * through
            turned = par + 2 * step + 1
            a, b, c = xd[turned], xd[turned + 1], xd[turned + 2]
            angle2 = a * a + b * b + c * c
            p, q = rodrigues(angle2)
            t0, t1, t2 = rotated(p, q, a, b, c, err[0], err[1], err[2])
            # a change of m turns further, by I + q [m x] + third [m x]^2 of it
            third = (1.0 - p) / angle2 if angle2 > 1e-3 else (1.0 - angle2 / 20.0 * (1.0 - angle2 / 42.0)) / 6.0
            for i in range(9):
                j0, j1, j2 = J[i, 3], J[i, 4], J[i, 5]
                if step == 0:
                    F[i, 9 + par] -= j0 * t0 + j1 * t1 + j2 * t2
                else:
                    F[i, 9 + par] -= j0 * t0
                    F[i, 10 + par] -= j1 * t1
                    F[i, 11 + par] -= j2 * t2
                j0, j1, j2 = (1.0 + xd[par]) * j0, (1.0 + xd[par + step]) * j1, (1.0 + xd[par + 2 * step]) * j2
                y0, y1, y2 = t1 * j2 - t2 * j1, t2 * j0 - t0 * j2, t0 * j1 - t1 * j0
                y0, y1, y2 = rotated(-q, third, a, b, c, y0, y1, y2)
                F[i, 9 + turned] -= y0
                F[i, 10 + turned] -= y1
                F[i, 11 + turned] -= y2
        _position_rows(nav, F, span, m)
        y0 = half * (nav[3] + w0 + u[0]) - l1[0] + l0[0]
        y1 = half * (nav[4] + w1 + u[1]) - l1[1] + l0[1]
        y2 = half * (nav[5] + w2 + u[2]) - l1[2] + l0[2]
        y0, y1, y2 = y0 + drv[BENT], y1 + drv[BENT + 1], y2 + drv[BENT + 2]
        known = per > 0.0 and span <= GAP_PERIODS * drv[PERIOD_S]
        _bend(drv, C, u[0] - north, u[1] - east, u[2], span * span / 12.0 if known else 0.0)
        y0, y1, y2 = y0 - drv[BENT], y1 - drv[BENT + 1], y2 - drv[BENT + 2]
        drv[WAY], drv[WAY + 1] = drv[WAY] + y0, drv[WAY + 1] + y1
        _move(nav, y0, y1, y2)
        for i in range(3):
            nav[3 + i] = v[i]
            drv[LEVER_VELOCITY + i] = w[i]
            for j in range(3):
                nav[6 + 3 * i + j] = C[i, j]
        _finish(xd, Phid, Qd, _ticks(span, drv), acc)
        for i in range(9):
            for j in range(9):
                for a in range(6):
                    Q[i, j] += J[i, a] * Cr[a, k] * J[j, a]
        if not blind and per > 0.0 and (e0 != 0.0 or e1 != 0.0 or e2 != 0.0):
            gained[0], gained[1], gained[2] = e0, e1, e2
            _shaken_arm(Q, J, X, drv, C, per, half, gained, samples[n, 1], samples[n, 2], Cr, wander)
        walk = drv[HOLD_DENSITY] ** 2 * span
        if span > GAP_PERIODS * drv[PERIOD_S] and not missing:
            for i in range(3):
                Q[i, i] += walk * span * span / 12.0  # a walk between two known velocities (Brownian bridge)
            turns = GAP_TURN**2 * span * (v[0] * v[0] + v[1] * v[1])  # and between two headings
            Q[0, 0] += turns * span * span / 12.0
            Q[1, 1] += turns * span * span / 12.0
        if missing:
            for i in range(3):
                Q[i, i] += walk * half * half
                Q[3 + i, 3 + i] += walk
                Q[i, 3 + i] += walk * half
                Q[3 + i, i] += walk * half
        if blind:
            Q[6, 6] += BLIND_TILT**2 * unread
            Q[7, 7] += BLIND_TILT**2 * unread
        if blind or held:
            Q[8, 8] += GAP_TURN**2 * unread
        if (blind or held) and unread > span:  # the way made meanwhile: the integral of a walk
            for i in range(2):
                a = -(nav[4] - east) if i == 0 else nav[3] - north
                for j in range(2):
                    b = -(nav[4] - east) if j == 0 else nav[3] - north
                    Q[i, j] += GAP_TURN**2 * unread**3 / 3.0 * a * b
                Q[i, 8] += GAP_TURN**2 * unread**2 / 2.0 * a
                Q[8, i] += GAP_TURN**2 * unread**2 / 2.0 * a
        drv[STARTED] = 1.0


@njit(cache=True, error_model="numpy")
def dead_reckoning_traced(nav, xd, drv, samples, Phid, Qd, Cr, acc, trace):
    """`dead_reckoning_steps` that leaves what each sample leaves, as `imu_traced` does."""
    if trace.shape[0] == 0:
        dead_reckoning_steps(nav, xd, drv, samples, Phid, Qd, Cr, acc)
    m = acc.shape[1]
    for n in range(trace.shape[0]):
        dead_reckoning_steps(nav, xd, drv, samples[n : n + 1], Phid, Qd, Cr, acc)
        _trace(nav, xd, trace[n])
        for i in range(2 * m):
            for j in range(m):
                trace[n, 8 + m + i * m + j] = acc[i, j]


@njit(cache=True, error_model="numpy")
def dead_reckoning_hold(nav, xd, drv, dt, Phid, Qd, Cr, acc):
    """Carry the state `dt` seconds past the last sample, see `_hold_on`; the blocks do not tick.

    It becomes less certain by how much turn and change of velocity were others in the interval before the last.
    """
    m = 9 + len(xd)
    F, Q = acc[2 * m : 3 * m], acc[m : 2 * m]
    _hold_on(nav, xd, drv, dt, F)
    _finish(xd, Phid, Qd, int(0), acc)
    # of all that is held since the sample, less what has been added already
    longer = (drv[HELD_S] + dt) ** 2 - drv[HELD_S] ** 2
    drv[HELD_S] += dt
    turned, gained = drv[TURN_CHANGE] ** 2 + drv[TURN_USUAL], drv[SPEED_CHANGE] ** 2 + drv[SPEED_USUAL]
    turned, gained = turned * longer, gained * longer
    flow, arm, half = int(drv[CURRENT]), int(drv[ARM]), drv[HELD_S] - 0.5 * drv[PERIOD_S]
    e0, e1, e2 = drv[LEVER], drv[LEVER + 1], drv[LEVER + 2]
    if arm >= 0:
        e0, e1, e2 = e0 + xd[arm], e1 + xd[arm + 1], e2 + xd[arm + 2]
    v0, v1, v2 = nav[3], nav[4], nav[5]
    if flow >= 0:  # the water does not turn
        v0, v1 = v0 - xd[flow], v1 - xd[flow + 1]
    # The next sample goes on from the velocity, the attitude and the arm of the last one, as if they erred by what has
    # changed since. So that nothing of that stays, the position errs by as much to the other side until then.
    G = np.zeros((9, 6))
    for i in range(3):
        a, b = (i + 1) % 3, (i + 2) % 3
        v = v0 if i == 0 else v1 if i == 1 else v2
        swing = nav[6 + 3 * i] * e0 + nav[7 + 3 * i] * e1 + nav[8 + 3 * i] * e2
        swing += 0.5 * drv[PERIOD_S] * drv[LEVER_VELOCITY + i]
        # the error of a velocity is that of the attitude times it, see at the head of this file
        G[3 + a, b], G[3 + b, a], G[6 + i, i], G[3 + i, 3 + i], G[i, 3 + i] = v, -v, 1.0, 1.0, half
        G[a, b], G[b, a] = half * v - swing, swing - half * v
    for i in range(9):
        for j in range(9):
            for k in range(6):
                Q[i, j] += G[i, k] * (turned if k < 3 else gained) * G[j, k]
