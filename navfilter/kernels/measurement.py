"""Measurement kernels: residual and Jacobian of every kind of sensor.

Each fills ``res`` (a,) = measured minus predicted, with NaN where a component is missing, and ``H`` (a, 9 + k):
derivative of the reading with respect to position, velocity, attitude (rotation vector in n) and the k parameters of
the sensor (scale, deviation ...). The coloured and white parts of the error are the filter's business. ``nav`` as in
the strapdown kernels; ``rate`` (3,) is the angular rate of the body against the Earth, in b [rad/s]; ``par`` (k,) the
parameters' estimates; ``cfg`` the sensor's constants.
"""

import math

import numpy as np

from navfilter.kernels import strapdown
from navfilter.kernels.compiling.decorators import UNCOUNTED, flat, njit, scratch, shaped
from navfilter.kernels.compiling.registers import all_of, eight, if_below, load, not_zero, store, transpose

PIECE_S = 0.02  # so long a turning force is taken as that of the middle: 1e-5 of it at 1 rad/s


@njit(cache=True, **UNCOUNTED)
def _clear(H):
    for i in range(H.shape[0]):
        for j in range(H.shape[1]):
            H[i, j] = 0.0


@njit(cache=True, inline="always")
def _in_n(nav, x, y, z):
    """The vector (x, y, z) of b in n."""
    north, east = nav[6] * x + nav[7] * y + nav[8] * z, nav[9] * x + nav[10] * y + nav[11] * z
    return north, east, nav[12] * x + nav[13] * y + nav[14] * z


@njit(cache=True, inline="always")
def _third(t2, p):
    """The factor after those of `strapdown.rodrigues`, (1 - p) / t2. With q and it in place of p and q the same form is
    J of ``exp([(v + dv) x]) = exp([J dv x]) exp([v x])``.
    """
    return (1.0 - p) / t2 if t2 > strapdown.SMALL_ANGLE2 else strapdown.P3 - t2 * (strapdown.P5 - strapdown.P7 * t2)


@njit(apart=True, cache=True, **UNCOUNTED)
def _instrument_velocity(z, nav, v0, v1, v2, rate, par, first, cfg, H, res):
    """Velocity v in n of the reference point, as seen by an instrument; scale (one, or one an axis) and misalignment,
    if any, are `par` from `first` on.

    The slope of the scale is that of v alone. What the rate adds on a lever arm has the noise of the gyros, which is in
    the residual as well, and the product of the two draws it to one side (Fuller, 1987, sec. 1.1): in waves, where no
    slope can be held, by 2 to 13 standard deviations. A mounting turns across that noise.
    """
    _clear(H)
    x0 = rate[1] * cfg[2] - rate[2] * cfg[1]
    x1 = rate[2] * cfg[0] - rate[0] * cfg[2]
    x2 = rate[0] * cfg[1] - rate[1] * cfg[0]
    for i in range(3):
        # n to instrument stands in the columns of the velocity, for a while
        A = H[i, 3:6]
        for j in range(3):
            A[j] = cfg[3 + i] * nav[6 + 3 * j] + cfg[6 + i] * nav[7 + 3 * j] + cfg[9 + i] * nav[8 + 3 * j]
        res[i] = A[0] * v0 + A[1] * v1 + A[2] * v2
    y0, y1, y2 = res[0], res[1], res[2]
    w0 = cfg[3] * x0 + cfg[6] * x1 + cfg[9] * x2
    w1 = cfg[4] * x0 + cfg[7] * x1 + cfg[10] * x2
    w2 = cfg[5] * x0 + cfg[8] * x1 + cfg[11] * x2
    g0, g1, g2, a, b, c = 1.0, 1.0, 1.0, 0.0, 0.0, 0.0
    step = 1 if len(par) - first == 6 else 0  # from one scale to the next
    turned = first + 1 + 2 * step
    if len(par) > first:
        g0, g1, g2 = 1.0 + par[first], 1.0 + par[first + step], 1.0 + par[first + 2 * step]
        a, b, c = par[turned], par[turned + 1], par[turned + 2]
    # the whole rotation: a series to second order is off by 0.01 deg at 6 deg, more than a mounting is told to
    angle2 = a * a + b * b + c * c
    p, q = strapdown.rodrigues(angle2)
    d0, d1, d2 = 1.0 - q * (b * b + c * c), 1.0 - q * (c * c + a * a), 1.0 - q * (a * a + b * b)
    e01, e02, e10 = q * a * b - p * c, q * a * c + p * b, q * a * b + p * c
    e12, e20, e21 = q * b * c - p * a, q * a * c - p * b, q * b * c + p * a
    t0, t1, t2 = d0 * y0 + e01 * y1 + e02 * y2, e10 * y0 + d1 * y1 + e12 * y2, e20 * y0 + e21 * y1 + d2 * y2
    s0, s1, s2 = t0, t1, t2
    t0 += d0 * w0 + e01 * w1 + e02 * w2
    t1 += e10 * w0 + d1 * w1 + e12 * w2
    t2 += e20 * w0 + e21 * w1 + d2 * w2
    res[0], res[1], res[2] = z[0] - g0 * t0, z[1] - g1 * t1, z[2] - g2 * t2
    for j in range(3):
        a0, a1, a2 = H[0, 3 + j], H[1, 3 + j], H[2, 3 + j]
        H[0, 3 + j] = g0 * (d0 * a0 + e01 * a1 + e02 * a2)
        H[1, 3 + j] = g1 * (e10 * a0 + d1 * a1 + e12 * a2)
        H[2, 3 + j] = g2 * (e20 * a0 + e21 * a1 + d2 * a2)
    for i in range(3):
        # C_nb' turns by -phi: d(C' v) = -C' (phi x v) = C' (v x phi)
        h0, h1, h2 = H[i, 3], H[i, 4], H[i, 5]
        H[i, 6] = h1 * v2 - h2 * v1
        H[i, 7] = h2 * v0 - h0 * v2
        H[i, 8] = h0 * v1 - h1 * v0
    if len(par) > first:
        s, m = 9 + first, 9 + turned
        H[0, s], H[1, s + step], H[2, s + 2 * step] = s0, s1, s2
        # a change of the k-th angle turns by column k of J: J_k x t
        r = _third(angle2, p)
        j00, j11, j22 = 1.0 - r * (b * b + c * c), 1.0 - r * (c * c + a * a), 1.0 - r * (a * a + b * b)
        j01, j02, j10 = r * a * b - q * c, r * a * c + q * b, r * a * b + q * c
        j12, j20, j21 = r * b * c - q * a, r * a * c - q * b, r * b * c + q * a
        H[0, m], H[1, m], H[2, m] = g0 * (j10 * t2 - j20 * t1), g1 * (j20 * t0 - j00 * t2), g2 * (j00 * t1 - j10 * t0)
        m += 1
        H[0, m], H[1, m], H[2, m] = g0 * (j11 * t2 - j21 * t1), g1 * (j21 * t0 - j01 * t2), g2 * (j01 * t1 - j11 * t0)
        m += 1
        H[0, m], H[1, m], H[2, m] = g0 * (j12 * t2 - j22 * t1), g1 * (j22 * t0 - j02 * t2), g2 * (j02 * t1 - j12 * t0)


@njit(cache=True, **UNCOUNTED)
def body_velocity(z, nav, rate, par, cfg, H, res):
    """Velocity at a lever arm in instrument axes: reading = (1 + s) R(m) y, y = M' (C_nb' v_n + rate x arm).

    cfg: lever arm (3), mounting matrix M instrument-to-body (9). par: none, or scale s (1, or 3: diagonal) and
    misalignment m (3).
    """
    _instrument_velocity(z, nav, nav[3], nav[4], nav[5], rate, par, int(0), cfg, H, res)


@njit(cache=True, **UNCOUNTED)
def water_velocity(z, nav, rate, par, cfg, H, res):
    """As `body_velocity`, but through water that moves: v_n less the current. par: current north, east, what else their
    models consist of, then as there from cfg[12] on.
    """
    _instrument_velocity(z, nav, nav[3] - par[0], nav[4] - par[1], nav[5], rate, par, int(cfg[12]), cfg, H, res)
    for i in range(3):
        H[i, 9], H[i, 10] = -H[i, 3], -H[i, 4]


@njit(cache=True)
def beam_velocity(z, nav, rate, par, cfg, H, res):
    """Velocities along four beams over ground, then along the same through water: reading = d (1 + s) R(m) y, y as
    for `body_velocity`.

    cfg: lever arm (3), mounting (9), unit vectors d of the beams in instrument axes (12), states of the current (0, 2).
    par: current north, east, if any; scale and misalignment, if any, as there.
    """
    first = int(cfg[24])
    part, Y = np.zeros(3), np.zeros((3, H.shape[1]))
    zero = np.zeros(3)
    _clear(H)
    for track in range(2):
        north, east = (par[0], par[1]) if track and first else (0.0, 0.0)
        _instrument_velocity(zero, nav, nav[3] - north, nav[4] - east, nav[5], rate, par, first, cfg, Y, part)
        for i in range(4):
            k, d = 4 * track + i, cfg[12 + 3 * i : 15 + 3 * i]
            res[k] = z[k] + d[0] * part[0] + d[1] * part[1] + d[2] * part[2]
            for j in range(H.shape[1]):
                H[k, j] = d[0] * Y[0, j] + d[1] * Y[1, j] + d[2] * Y[2, j]
            if track and first:
                H[k, 9], H[k, 10] = -H[k, 3], -H[k, 4]


@njit(cache=True, **UNCOUNTED)
def _bearing(n0, n1, n2, H):
    """Azimuth of a vector given in n, and its derivative with respect to a rotation vector in n."""
    h2 = n0 * n0 + n1 * n1
    if h2 < 1e-300:
        return math.nan  # a vertical vector has no azimuth
    H[0, 6], H[0, 7], H[0, 8] = -n2 * n0 / h2, -n2 * n1 / h2, 1.0
    return math.atan2(n1, n0)


@njit(apart=True, cache=True, **UNCOUNTED)
def _deviation(psi, par, H, temperature, cfg):
    """Compass error that follows the heading: bias, one- and two-cycle deviation, temperature. Returns its value and
    slope.
    """
    s1, c1 = math.sin(psi), math.cos(psi)
    s2, c2 = 2.0 * s1 * c1, c1 * c1 - s1 * s1
    warm = 0.0 if math.isnan(temperature) else temperature - cfg[1]
    H[0, 9], H[0, 10], H[0, 11], H[0, 12], H[0, 13], H[0, 14] = 1.0, s1, c1, s2, c2, warm
    value = par[0] + par[1] * s1 + par[2] * c1 + par[3] * s2 + par[4] * c2 + par[5] * warm
    return value, par[1] * c1 - par[2] * s1 + 2.0 * (par[3] * c2 - par[4] * s2)


@njit(cache=True, **UNCOUNTED)
def heading(z, nav, rate, par, cfg, H, res):
    """Compass output: reading = true heading - declination + deviation(heading), wrapped to half a turn.

    z: heading [rad], temperature (NaN if unknown). cfg: declination [rad], reference temperature. par: none, or bias,
    one-cycle (sin, cos), two-cycle (sin, cos), temperature coefficient.
    """
    _clear(H)
    psi = _bearing(nav[6], nav[9], nav[12], H) - cfg[0]
    predicted = psi
    if len(par) > 0:
        value, slope = _deviation(psi, par, H, z[1], cfg)
        predicted += value
        for j in range(6, 9):
            H[0, j] *= 1.0 + slope
    r = z[0] - predicted
    res[0] = r - 2.0 * math.pi * math.floor(r / (2.0 * math.pi) + 0.5)


@njit(cache=True, **UNCOUNTED)
def magnetometer(z, nav, rate, par, cfg, H, res):
    """Three-axis magnetometer levelled with the filter's own attitude; the residual is the error of the magnetic
    azimuth.

    z: field in b (any unit), temperature. cfg: declination, reference temperature, where in par hard iron h (3) and
    soft iron A (5: xx = -yy, zz, xy, xz, yz) begin, -1 for none: field = (I + A) z - h. It is linear in both, and no
    scale of the whole is left open, or noise would seem to show what no reading does. par before that as for `heading`.
    """
    _clear(H)
    hard, soft = int(cfg[2]), int(cfg[3])
    m0, m1, m2 = z[0], z[1], z[2]
    f0, f1, f2 = m0, m1, m2
    if soft >= 0:
        xx, zz, xy, xz, yz = par[soft], par[soft + 1], par[soft + 2], par[soft + 3], par[soft + 4]
        f0 += xx * m0 + xy * m1 + xz * m2
        f1 += xy * m0 - xx * m1 + yz * m2
        f2 += xz * m0 + yz * m1 + zz * m2
    if hard >= 0:
        f0, f1, f2 = f0 - par[hard], f1 - par[hard + 1], f2 - par[hard + 2]
    n0, n1, n2 = _in_n(nav, f0, f1, f2)
    h2 = n0 * n0 + n1 * n1
    if h2 < 1e-300:
        res[0] = math.nan  # a vertical field has no azimuth
        return
    predicted, slope, p0, p1 = 0.0, 0.0, 0.0, 0.0
    if len(par) > 0 and hard != 0 and soft != 0:
        psi = _bearing(nav[6], nav[9], nav[12], H) - cfg[0]
        p0, p1 = H[0, 6], H[0, 7]
        predicted, slope = _deviation(psi, par, H, z[3], cfg)
    # A compass that reads too high sees the field turned to the left: reading error = -(azimuth of the levelled field -
    # declination).
    r = cfg[0] - math.atan2(n1, n0) - predicted
    r -= 2.0 * math.pi * math.floor(r / (2.0 * math.pi) + 0.5)
    res[0] = r
    # Slopes are those of the field as it should have been read: in those of the reading is its own error, which the
    # residual shows, and soft iron is learnt from the product of the two.
    turned, across = math.cos(r) - 1.0, math.sin(r)
    d0, d1 = turned * n0 - across * n1, across * n0 + turned * n1
    n0, n1 = n0 + d0, n1 + d1
    m0, m1, m2 = m0 + nav[6] * d0 + nav[9] * d1, m1 + nav[7] * d0 + nav[10] * d1, m2 + nav[8] * d0 + nav[11] * d1
    _bearing(n0, n1, n2, H)
    H[0, 6], H[0, 7], H[0, 8] = H[0, 6] + slope * p0, H[0, 7] + slope * p1, 1.0 + slope
    # how the azimuth grows with the field in b
    g0 = (nav[9] * n0 - nav[6] * n1) / h2
    g1 = (nav[10] * n0 - nav[7] * n1) / h2
    g2 = (nav[11] * n0 - nav[8] * n1) / h2
    if hard >= 0:
        H[0, 9 + hard], H[0, 10 + hard], H[0, 11 + hard] = -g0, -g1, -g2
    if soft >= 0:
        s = 9 + soft
        H[0, s], H[0, s + 1] = g0 * m0 - g1 * m1, g2 * m2
        H[0, s + 2], H[0, s + 3], H[0, s + 4] = g0 * m1 + g1 * m0, g0 * m2 + g2 * m0, g1 * m2 + g2 * m1


@njit(cache=True, **UNCOUNTED)
def depth(z, nav, rate, par, cfg, H, res):
    """Depth at a lever arm: reading = surface height - (height of the vehicle - down component of C_nb arm) + offset.

    cfg: lever arm (3), height of the surface [m]. par: none or the offset [m].
    """
    _clear(H)
    a0, a1, a2 = _in_n(nav, cfg[0], cfg[1], cfg[2])
    res[0] = z[0] - (cfg[3] - nav[2] + a2)
    H[0, 2] = 1.0
    H[0, 6], H[0, 7] = a1, -a0  # third component of phi x arm
    if len(par) > 0:
        res[0] -= par[0]
        H[0, 9] = 1.0


@njit(cache=True, **UNCOUNTED)
def altitude(z, nav, rate, par, cfg, H, res):
    """Height of a lever arm above the bottom: reading = height - down component of C_nb arm - height of the bottom.

    cfg: lever arm (3), described height of the bottom [m]. par: none, or how much higher the bottom is [m].
    """
    _clear(H)
    a0, a1, a2 = _in_n(nav, cfg[0], cfg[1], cfg[2])
    res[0] = z[0] - (nav[2] - a2 - cfg[3])
    H[0, 2], H[0, 6], H[0, 7] = -1.0, -a1, a0
    if len(par) > 0:
        res[0] += par[0]
        H[0, 9] = -1.0


@njit(cache=True, **UNCOUNTED)
def position(z, nav, rate, par, cfg, H, res):
    """Antenna position: latitude, longitude [rad], height [m] against the vehicle plus its lever arm, in metres in n.
    cfg: arm (3).
    """
    _clear(H)
    a0, a1, a2 = _in_n(nav, cfg[0], cfg[1], cfg[2])
    turn = z[1] - nav[1]
    turn -= 2.0 * math.pi * math.floor(turn / (2.0 * math.pi) + 0.5)
    res[0] = (z[0] - nav[0]) * nav[15] - a0
    res[1] = turn * nav[16] * math.cos(0.5 * (z[0] + nav[0])) - a1
    res[2] = nav[2] - z[2] - a2
    for i in range(3):
        H[i, i] = 1.0
    H[0, 7], H[0, 8] = a2, -a1
    H[1, 6], H[1, 8] = -a2, a0
    H[2, 6], H[2, 7] = a1, -a0


@njit(cache=True, **UNCOUNTED)
def _earth_axes(latitude, longitude, height, radius, e2, A, p):
    """Rows of A: north, east and down in the Earth's axes; p: the point itself there [m]."""
    s, c, so, co = math.sin(latitude), math.cos(latitude), math.sin(longitude), math.cos(longitude)
    across = radius / math.sqrt(1.0 - e2 * s * s)
    p[0], p[1], p[2] = (across + height) * c * co, (across + height) * c * so, (across * (1.0 - e2) + height) * s
    A[0, 0], A[0, 1], A[0, 2] = -s * co, -s * so, c
    A[1, 0], A[1, 1], A[1, 2] = -so, co, 0.0
    A[2, 0], A[2, 1], A[2, 2] = -c * co, -c * so, -s


@njit(cache=True)
def slant_range(z, nav, rate, par, cfg, H, res):
    """Distance from a lever arm to a beacon: reading = (1 + s) |beacon + its error - vehicle - C_nb arm| + offset.

    z: distance [m], number of the beacon from 0. cfg: the Earth's radius [m] and squared eccentricity, lever arm (3),
    where in par scale, offsets (one a beacon) and errors of the beacons north, east, down (three each) begin, -1 for
    none; then the beacons in the Earth's axes [m], and what `consistency.range_second_order` needs.
    """
    _clear(H)
    A, p, d, a = np.empty((3, 3)), np.empty(3), np.empty(3), np.empty(3)
    _earth_axes(nav[0], nav[1], nav[2], cfg[0], cfg[1], A, p)
    beacon, scale, offset, place = int(z[1]), int(cfg[5]), int(cfg[6]), int(cfg[7])
    at = 8 + 3 * beacon
    distance = 0.0
    for i in range(3):
        a[i] = nav[6 + 3 * i] * cfg[2] + nav[7 + 3 * i] * cfg[3] + nav[8 + 3 * i] * cfg[4]
        d[i] = -a[i]
        for j in range(3):
            d[i] += A[i, j] * (cfg[at + j] - p[j])
        if place >= 0:
            d[i] += par[place + 3 * beacon + i]
        distance += d[i] * d[i]
    distance = math.sqrt(distance)
    if distance < 1e-6:
        res[0] = math.nan  # at the beacon itself there is no direction
        return
    g = 1.0 + par[scale] if scale >= 0 else 1.0
    res[0] = z[0] - g * distance
    for i in range(3):
        d[i] *= g / distance
        H[0, i] = -d[i]
        if place >= 0:
            H[0, 9 + place + 3 * beacon + i] = d[i]
    H[0, 6], H[0, 7], H[0, 8] = a[2] * d[1] - a[1] * d[2], a[0] * d[2] - a[2] * d[0], a[1] * d[0] - a[0] * d[1]
    if scale >= 0:
        H[0, 9 + scale] = distance
    if offset >= 0:
        res[0] -= par[offset + beacon]
        H[0, 9 + offset + beacon] = 1.0


@njit(cache=True)
def _rotation(m, out, by):
    """The rotation by a vector m, and the matrix (3, 3) by which a change of m turns it further."""
    angle2 = m[0] * m[0] + m[1] * m[1] + m[2] * m[2]
    p, q = strapdown.rodrigues(angle2)
    r = _third(angle2, p)
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        out[i, i], by[i, i] = 1.0 + q * (m[i] * m[i] - angle2), 1.0 + r * (m[i] * m[i] - angle2)
        out[k, j], by[k, j] = p * m[i] + q * m[j] * m[k], q * m[i] + r * m[j] * m[k]
        out[j, k], by[j, k] = -p * m[i] + q * m[j] * m[k], -q * m[i] + r * m[j] * m[k]


@njit(cache=True)
def usbl(z, nav, rate, par, cfg, H, res):
    """Where a transponder stands as seen by a transceiver: its range, and the direction across and below the line of
    sight that was measured.

    z: range [m], bearing from the transceiver's first axis to its second and elevation towards its third [rad]; the
    transceiver in the Earth's axes [m] (3), and the rotation from these into its own (9). cfg: the Earth's radius [m]
    and squared eccentricity, lever arm (3), where in par scale of the range, misalignment (3) and error of the ship's
    place north, east, down (3) begin, -1 for none.
    """
    _clear(H)
    A, D, p, turn, by = np.empty((3, 3)), np.empty((3, 3)), np.empty(3), np.empty((3, 3)), np.empty((3, 3))
    a, d, e, J, m = np.empty(3), np.empty(3), np.zeros(3), np.zeros((3, 3)), np.zeros(3)
    _earth_axes(nav[0], nav[1], nav[2], cfg[0], cfg[1], A, p)
    scale, turned, ship = int(cfg[5]), int(cfg[6]), int(cfg[7])
    for i in range(3):
        a[i] = nav[6 + 3 * i] * cfg[2] + nav[7 + 3 * i] * cfg[3] + nav[8 + 3 * i] * cfg[4]
    for i in range(3):
        d[i] = 0.0
        for j in range(3):
            t = z[6 + 3 * i : 9 + 3 * i]
            D[i, j] = t[0] * A[j, 0] + t[1] * A[j, 1] + t[2] * A[j, 2]  # n to transceiver
            d[i] += t[j] * (p[j] - z[3 + j]) + D[i, j] * (a[j] + (par[ship + j] if ship >= 0 else 0.0))
    if turned >= 0:
        m[0], m[1], m[2] = par[turned], par[turned + 1], par[turned + 2]
    _rotation(m, turn, by)
    for i in range(3):
        e[i] = turn[i, 0] * d[0] + turn[i, 1] * d[1] + turn[i, 2] * d[2]
    # a mounting turns the direction, and leaves the range as it is
    distance = math.sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2])
    r = math.sqrt(e[0] * e[0] + e[1] * e[1] + e[2] * e[2])
    if distance < 1e-6:
        res[0], res[1], res[2] = math.nan, math.nan, math.nan
        return
    g = 1.0 + par[scale] if scale >= 0 else 1.0
    res[0] = z[0] - g * distance
    if scale >= 0:
        H[0, 9 + scale] = distance
    bearing, elevation = 0.0 if math.isnan(z[1]) else z[1], 0.0 if math.isnan(z[2]) else z[2]
    sb, cb, se, ce = math.sin(bearing), math.cos(bearing), math.sin(elevation), math.cos(elevation)
    J[0, 0], J[0, 1], J[0, 2] = g * d[0] / distance, g * d[1] / distance, g * d[2] / distance
    J[1, 0], J[1, 1] = -sb, cb
    J[2, 0], J[2, 1], J[2, 2] = -se * cb, -se * sb, ce
    ahead = ce * cb * e[0] + ce * sb * e[1] + se * e[2]
    for k in range(1, 3):
        along = (J[k, 0] * e[0] + J[k, 1] * e[1] + J[k, 2] * e[2]) / r
        res[k] = -along if ahead > 0.0 else math.pi  # what lies behind is no small angle
        if math.isnan(z[1]) or math.isnan(z[k]):
            res[k] = math.nan
        for i in range(3):
            J[k, i] = (J[k, i] - along * e[i] / r) / r
    for k in range(3):
        q0, q1, q2 = J[k, 0], J[k, 1], J[k, 2]
        if turned >= 0 and k:
            for j in range(3):
                x0, x1, x2 = e[1] * q2 - e[2] * q1, e[2] * q0 - e[0] * q2, e[0] * q1 - e[1] * q0
                H[k, 9 + turned + j] = by[0, j] * x0 + by[1, j] * x1 + by[2, j] * x2
        if k:  # back through the rotation
            q0, q1, q2 = (
                turn[0, 0] * q0 + turn[1, 0] * q1 + turn[2, 0] * q2,
                turn[0, 1] * q0 + turn[1, 1] * q1 + turn[2, 1] * q2,
                turn[0, 2] * q0 + turn[1, 2] * q1 + turn[2, 2] * q2,
            )
        for j in range(3):
            H[k, j] = q0 * D[0, j] + q1 * D[1, j] + q2 * D[2, j]
            if ship >= 0:
                H[k, 9 + ship + j] = H[k, j]
        h0, h1, h2 = H[k, 0], H[k, 1], H[k, 2]
        H[k, 6], H[k, 7], H[k, 8] = a[1] * h2 - a[2] * h1, a[2] * h0 - a[0] * h2, a[0] * h1 - a[1] * h0


@njit(cache=True, **UNCOUNTED)
def _angle_slopes(C, D, H, column):
    """How roll, pitch and yaw of C change when C changes by D."""
    level2 = C[0, 0] * C[0, 0] + C[1, 0] * C[1, 0]
    along = C[0, 0] * D[0, 0] + C[1, 0] * D[1, 0]
    H[0, column] = (C[2, 2] * D[2, 1] - C[2, 1] * D[2, 2]) / (C[2, 1] * C[2, 1] + C[2, 2] * C[2, 2])
    H[1, column] = (C[2, 0] * along / level2 - D[2, 0]) * math.sqrt(level2) / (level2 + C[2, 0] * C[2, 0])
    H[2, column] = (C[0, 0] * D[1, 0] - C[1, 0] * D[0, 0]) / level2


@njit(cache=True)
def attitude(z, nav, rate, par, cfg, H, res):
    """Roll, pitch and yaw of an instrument's own axes, C_nb M R(m)', roll and yaw wrapped to half a turn.

    z: the three angles [rad]. cfg: declination [rad], mounting matrix M instrument-to-body (9). par: none or
    misalignment m (3).
    """
    _clear(H)
    C, B, turn, by = np.empty((3, 3)), np.empty((3, 3)), np.eye(3), np.empty((3, 3))
    if len(par) > 0:
        _rotation(par, turn, by)
    for i in range(3):
        for j in range(3):
            B[i, j] = nav[6 + 3 * i] * cfg[1 + j] + nav[7 + 3 * i] * cfg[4 + j] + nav[8 + 3 * i] * cfg[7 + j]
        for j in range(3):
            C[i, j] = B[i, 0] * turn[j, 0] + B[i, 1] * turn[j, 1] + B[i, 2] * turn[j, 2]
    level = math.sqrt(C[0, 0] * C[0, 0] + C[1, 0] * C[1, 0])
    upright = C[2, 1] * C[2, 1] + C[2, 2] * C[2, 2]
    if level < 1e-6 or upright < 1e-12:
        res[0], res[1], res[2] = math.nan, math.nan, math.nan
        return
    res[0] = z[0] - math.atan2(C[2, 1], C[2, 2])
    res[1] = z[1] + math.atan2(C[2, 0], level)
    res[2] = z[2] - math.atan2(C[1, 0], C[0, 0]) + cfg[0]
    for i in (0, 2):
        res[i] -= 2.0 * math.pi * math.floor(res[i] / (2.0 * math.pi) + 0.5)
    D = np.empty((3, 3))
    for j in range(3):
        k, m = (j + 1) % 3, (j + 2) % 3
        for i in range(3):
            D[j, i], D[k, i], D[m, i] = 0.0, -C[m, i], C[k, i]  # a rotation about axis j of n
        _angle_slopes(C, D, H, 6 + j)
        if len(par) > 0:
            x, y, w = by[0, j], by[1, j], by[2, j]
            for i in range(3):
                # against a rotation about (x, y, w) of the instrument
                D[i, 0], D[i, 1] = C[i, 2] * y - C[i, 1] * w, C[i, 0] * w - C[i, 2] * x
                D[i, 2] = C[i, 1] * x - C[i, 0] * y
            _angle_slopes(C, D, H, 9 + j)


@njit(cache=True, **UNCOUNTED)
def ground_velocity(z, nav, rate, par, cfg, H, res):
    """Velocity over ground in n [m/s] at a lever arm: v_n + C_nb (rate x arm). cfg: lever arm (3)."""
    _clear(H)
    x0 = rate[1] * cfg[2] - rate[2] * cfg[1]
    x1 = rate[2] * cfg[0] - rate[0] * cfg[2]
    x2 = rate[0] * cfg[1] - rate[1] * cfg[0]
    w0, w1, w2 = _in_n(nav, x0, x1, x2)
    res[0], res[1], res[2] = z[0] - nav[3] - w0, z[1] - nav[4] - w1, z[2] - nav[5] - w2
    for i in range(3):
        H[i, 3 + i] = 1.0
    H[0, 7], H[0, 8] = w2, -w1
    H[1, 6], H[1, 8] = -w2, w0
    H[2, 6], H[2, 7] = w1, -w0


@njit(cache=True, **UNCOUNTED)
def velocity(z, nav, rate, par, cfg, H, res):
    """Velocity over ground in n [m/s] (zero when the vehicle stands still)."""
    _clear(H)
    for i in range(3):
        res[i] = z[i] - nav[3 + i]
        H[i, 3 + i] = 1.0


@njit(cache=True, **UNCOUNTED)
def earth_rate(z, nav, rate, par, cfg, H, res):
    """Rate in b [rad/s] of a body that does not turn on the Earth: the Earth's own, ``C_nb' (cos, 0, -sin latitude)``.

    cfg: the Earth's rate [rad/s].
    """
    _clear(H)
    north, down = cfg[0] * math.cos(nav[0]), -cfg[0] * math.sin(nav[0])
    for i in range(3):
        a, b, c = nav[6 + i], nav[9 + i], nav[12 + i]
        res[i] = z[i] - a * north - c * down
        H[i, 0] = (a * down - c * north) / nav[15]
        # C_nb' turns by -phi: C' (w x phi)
        H[i, 6], H[i, 7], H[i, 8] = b * down, c * north - a * down, -b * north


@njit(cache=True, inline="always")
def _piece_back(state, down, dt, x, y, z, p, q, a, b, c):
    """What is carried, see `_stepped_back`, before a piece in which the body turns by (x, y, z), p and q see
    `strapdown.rodrigues`, and (a, b, c) is the change of velocity in the attitude behind it.
    """
    u, v, w, speed, way, once, twice = state
    by, half, pull = all_of(dt), all_of(0.5 * dt), all_of(dt) * down
    force = all_of(a) * u + all_of(b) * v + all_of(c) * w
    way = way + by * speed - half * (force + pull)
    twice = twice + by * once + half * force
    once, speed = once + force, speed - force - pull
    u, v, w = strapdown.rotated(all_of(p), all_of(q), all_of(x), all_of(y), all_of(z), u, v, w)
    return u, v, w, speed, way, once, twice


@njit(cache=True, inline="always")
def _series(t2):
    """`strapdown.rodrigues` of eight small angles."""
    return (
        all_of(1.0) - t2 * (all_of(strapdown.P3) - t2 * (all_of(strapdown.P5) - all_of(strapdown.P7) * t2)),
        all_of(0.5) - t2 * (all_of(strapdown.Q4) - t2 * (all_of(strapdown.Q6) - all_of(strapdown.Q8) * t2)),
    )


@njit(cache=True, **UNCOUNTED)
def _eight_pieces(motion, k, span, work):
    """What `_piece_back` is told of eight intervals from k on, one a column of `work` (9, 8). Returns what they leave
    of the span, or -1 where they do not lie in it, or have to be taken one by one.
    """
    for i in range(k, k + 8):
        if motion[i, 0] > PIECE_S:
            return -1.0
        span -= motion[i, 0]
    if span < 0.0:
        return -1.0
    transpose(flat(motion), 7 * k - 1, int(7), flat(work), int(0), int(8))
    dt = load(work, 1)
    x, y, z = dt * load(work, 2), dt * load(work, 3), dt * load(work, 4)
    a, b, c = dt * load(work, 5), dt * load(work, 6), dt * load(work, 7)
    t2 = x * x + y * y + z * z
    if not_zero(if_below(t2, all_of(strapdown.SMALL_ANGLE2), all_of(0.0), all_of(1.0))) > 0:
        return -1.0
    p, q = _series(all_of(0.25) * t2)
    a, b, c = strapdown.rotated(p, q, all_of(-0.5) * x, all_of(-0.5) * y, all_of(-0.5) * z, a, b, c)
    p, q = _series(t2)
    store(work, 0, dt)
    store(work, 1, x)
    store(work, 2, y)
    store(work, 3, z)
    store(work, 4, p)
    store(work, 5, q)
    store(work, 6, a)
    store(work, 7, b)
    store(work, 8, c)
    return span


@njit(cache=True, **UNCOUNTED)
def _stepped_back(X, motion, gravity, span, work):
    """Attitude, velocity and sums carried back by `span` in the intervals of motion, at the constant rate and specific
    force in b of each, in pieces of at most `PIECE_S`. Returns what is left of the span.

    X: values of eight numbers, of which the first three are meant, north, east and down: columns of C_nb, velocity,
    way, time integrals of the specific force in n, once and twice, and where gravity acts, 1. work (9, 8).
    """
    state = load(X, 0), load(X, 1), load(X, 2), load(X, 3), load(X, 4), load(X, 5), load(X, 6)
    down, k, rows = load(X, 7) * all_of(gravity), 0, motion.shape[0]
    while k < rows and span != 0.0:
        if 0 < k <= rows - 8:
            rest = _eight_pieces(motion, k, span, work)
            if rest >= 0.0:
                for i in range(8):
                    dt, x, y, z, p = work[0, i], work[1, i], work[2, i], work[3, i], work[4, i]
                    q, a, b, c = work[5, i], work[6, i], work[7, i], work[8, i]
                    state = _piece_back(state, down, dt, x, y, z, p, q, a, b, c)
                k, span = k + 8, rest
                continue
        dt, pieces = min(motion[k, 0], span), 1
        span -= dt
        if abs(dt) > PIECE_S:
            pieces = math.ceil(abs(dt) / PIECE_S)
            dt /= pieces
        # angle and change of velocity
        x, y, z, a, b, c = motion[k, 1], motion[k, 2], motion[k, 3], motion[k, 4], motion[k, 5], motion[k, 6]
        x, y, z, a, b, c = dt * x, dt * y, dt * z, dt * a, dt * b, dt * c
        t2 = x * x + y * y + z * z
        p, q = strapdown.rodrigues(0.25 * t2)
        a, b, c = strapdown.rotated(p, q, -0.5 * x, -0.5 * y, -0.5 * z, a, b, c)
        p, q = strapdown.rodrigues(t2)
        for _ in range(pieces):
            state = _piece_back(state, down, dt, x, y, z, p, q, a, b, c)
        k += 1
    u, v, w, speed, way, once, twice = state
    store(X, 0, u)
    store(X, 1, v)
    store(X, 2, w)
    store(X, 3, speed)
    store(X, 4, way)
    store(X, 5, once)
    store(X, 6, twice)
    return span


@njit(cache=True, **UNCOUNTED)
def _gathered(motion, ages, sums):
    """Integrals of rates and forces up to each of some ages (q,), which grow, from the one before, into rows of `sums`
    (q, 8), behind its first two numbers; the first one is over what time any are known. Returns the oldest interval of
    these, -1 for none.
    """
    whole, total, at, age, known, last, q = flat(motion), all_of(0.0), 0.0, 0.0, 0.0, -1, 0
    for k in range(motion.shape[0]):
        if motion[k, 0] <= 0.0:
            continue
        if k == 0:  # nothing stands before it
            sums[0, 0] = 0.0
            for j in range(7):
                sums[0, 1 + j] = motion[0, j]
        values, last, age = eight(whole, 7 * k - 1) if k > 0 else load(sums, 0), k, age + motion[k, 0]
        while q < ages.size and ages[q] <= age:
            store(sums, q, total + all_of(ages[q] - at) * values)
            sums[q, 0] = known + (ages[q] - at)
            total, at, known, q = all_of(0.0), ages[q], 0.0, q + 1
        if q == ages.size:
            return last
        total, known, at = total + all_of(age - at) * values, known + (age - at), age
    for i in range(q, ages.size):
        store(sums, i, total)
        sums[i, 0], total, known = known, all_of(0.0), 0.0
    return last


@njit(cache=True, **UNCOUNTED)
def _mean_of(motion, last, sums, i, j, mean):
    """Mean of rates and forces (6,) from one to another of the rows of `_gathered`; where nothing is known of then, the
    oldest that is.
    """
    known = sums[i, 0] + sums[j, 0] if i != j else sums[i, 0]
    for c in range(6):
        if known > 0.0:
            mean[c] = (sums[i, 2 + c] + sums[j, 2 + c] if i != j else sums[i, 2 + c]) / known
        else:
            mean[c] = motion[last, 1 + c] if last >= 0 else 0.0


@njit(cache=True, **UNCOUNTED)
def _motion_about(motion, last, sums, width, half, mean, growth):
    """Mean of rates and forces (6,) over a window about the third of five ages, from the second to the fourth (width 1)
    or from the first to the last (width 2), half of it before and half of it behind; and how fast they grow.
    """
    _mean_of(motion, last, sums, int(3), 2 + width, growth)
    _mean_of(motion, last, sums, 3 - width, int(2), mean)
    for i in range(6):
        step = mean[i] - growth[i]
        mean[i] -= 0.5 * step
        growth[i] = step / half


@njit(cache=True, **UNCOUNTED)
def _back_to(nav, motion, gravity, late_s, window_s, slope_s, then, turn, slope, B, work):
    """As `earlier`, which says what is given; work: 221."""
    X, C, v, by = work[:64], work[64:73], work[73:76], work[76:85]
    mean, growth, ahead = work[85:91], work[91:97], work[97:104]
    ages, sums, pieces = work[104:109], shaped(work[109:149], 5, 8), shaped(work[149:221], 9, 8)
    for i in range(17):
        then[i] = nav[i]
    for i in range(64):
        X[i] = 0.0
    for i in range(3):
        for j in range(3):
            X[8 * j + i] = nav[6 + 3 * i + j]
        X[24 + i] = nav[3 + i]
    X[58] = 1.0
    # windows end now at the latest: both have the same middle
    over_s, centre = min(slope_s, max(2.0 * late_s, window_s)), max(late_s, 0.5 * window_s)
    for i in range(5):
        half = 0.5 * (over_s if i % 4 == 0 else window_s)
        ages[i] = centre + (half if i > 2 else -half if i < 2 else 0.0)
    last = _gathered(motion, ages, sums)
    _motion_about(motion, last, sums, int(1), 0.5 * window_s, mean, growth)
    # from the middle of the window to that of what is to come
    further = centre - 0.5 * late_s if late_s < 0.0 else 0.0
    for i in range(3):
        turn[i] = mean[i] + (centre - late_s) * growth[i]
        ahead[1 + i], ahead[4 + i] = mean[i] + further * growth[i], mean[3 + i]
    ahead[0] = late_s
    if late_s > 0.0:
        ahead[0] = _stepped_back(X, motion, gravity, late_s, pieces)
    _stepped_back(X, shaped(ahead, 1, 7), gravity, ahead[0], pieces)
    for i in range(3):
        for j in range(3):
            C[3 * i + j] = X[8 * j + i]
        v[i] = X[24 + i]
        by[i], by[3 + i], by[6 + i] = X[32 + i], X[40 + i], X[48 + i]
    latitude = nav[0] - by[0] / nav[15]
    then[0], then[2] = latitude, nav[2] + by[2]
    then[1] = nav[1] - by[1] / (nav[16] * math.cos(0.5 * (latitude + nav[0])))
    then[15], then[16] = nav[15] + by[2], nav[16] + by[2]
    _motion_about(motion, last, sums, int(2), 0.5 * over_s, mean, growth)
    for i in range(3):
        then[3 + i], slope[0, i], turn[3 + i] = v[i], v[i], growth[i]
        mean[i] += (centre - late_s) * growth[i]
    for i in range(3):
        for j in range(2):
            of = growth if j else mean
            slope[j, 3 + i] = C[3 * i] * of[3] + C[3 * i + 1] * of[4] + C[3 * i + 2] * of[5]
            slope[j, 6 + i] = C[3 * i] * of[0] + C[3 * i + 1] * of[1] + C[3 * i + 2] * of[2]
    slope[0, 5] += gravity
    for i in range(3):
        slope[1, i] = slope[0, 3 + i]
    for i in range(9):
        then[6 + i] = C[i]
        for j in range(9):
            B[i, j] = 1.0 if i == j else 0.0
    for i in range(3):
        B[i, 3 + i] = -late_s
    # an error of the attitude turns the forces that are taken back: D x phi of the velocity, -S x phi of the place
    D0, D1, D2, S0, S1, S2 = by[3], by[4], by[5], by[6], by[7], by[8]
    B[3, 7], B[3, 8], B[4, 6], B[4, 8], B[5, 6], B[5, 7] = -D2, D1, D2, -D0, -D1, D0
    B[0, 7], B[0, 8], B[1, 6], B[1, 8], B[2, 6], B[2, 7] = S2, -S1, -S2, S0, S1, -S0
    return over_s


@njit(apart=True, cache=True, **UNCOUNTED)
def earlier(nav, motion, gravity, late_s, window_s, slope_s, then, turn, slope, B):
    """The state `late_s` before `nav`, from what the drive felt since; a negative `late_s` looks ahead.

    motion (k, 7): intervals, the newest first: seconds (0: nothing known), angular rate and specific force in b, their
    errors taken off. Where it does not reach, the mean motion about then goes on (ahead: turning faster and faster, or
    slower, as in the newest of it). `gravity` acts down. The Earth's rate
    and Coriolis force are left out: 2e-5 rad and 1 mm/s at 10 m/s in 0.3 s.

    Fills: then (17,); turn (6,), angular rate in b, a mean over `window_s` about then, for vibration is no motion, and
    angular acceleration; slope (2, 9), derivative of the state with time: velocity, acceleration, angular rate in n,
    and how these grow; B (9, 9), derivative of the errors then with respect to those now. Accelerations and slopes are
    means over `slope_s` about then, or a time so much shorter that it ends now; returns over what time.
    """
    work = flat(scratch(np.float64, int(1), int(221)))
    return _back_to(nav, motion, gravity, late_s, window_s, slope_s, then, turn, slope, B, work)
