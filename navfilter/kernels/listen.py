"""Kernels that take the filter's own feedback off again, so that a sensor's error can be learnt from its readings.

``undone`` holds the sum of what corrections fed back, carried along like an error of the state: position and velocity in n, heading
(element 8), the drive's states, and behind them the velocity in b. An open loop would read higher residuals by H times that sum.
"""

import math

from numba import njit

NOTHING, HEADING, POSITION, VELOCITY = 0, 1, 2, 3


@njit(cache=True)
def carry(undone, Phi):
    """Carry the sum over a compound transition Phi (m x m): position by velocity, heading by the gyros' states.

    Tilt and horizontal accelerometer states stay in the closed loop: only their sum shows, and the chain of the channel's model pays for it.
    """
    m = Phi.shape[0]
    p0, p1, p2, v0, v1, v2 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for j in range(3):
        p0 += Phi[0, j] * undone[j] + Phi[0, 3 + j] * undone[3 + j]
        p1 += Phi[1, j] * undone[j] + Phi[1, 3 + j] * undone[3 + j]
        p2 += Phi[2, j] * undone[j] + Phi[2, 3 + j] * undone[3 + j]
        v0 += Phi[3, 3 + j] * undone[3 + j]
        v1 += Phi[4, 3 + j] * undone[3 + j]
        v2 += Phi[5, 3 + j] * undone[3 + j]
    for j in range(9, m):
        p2 += Phi[2, j] * undone[j]
        v2 += Phi[5, j] * undone[j]
        undone[8] += Phi[8, j] * undone[j]
    for i in range(9, m):
        s = 0.0
        for j in range(9, m):
            s += Phi[i, j] * undone[j]
        undone[m + 3 + i - 9] = s
    for i in range(9, m):
        undone[i] = undone[m + 3 + i - 9]
    undone[0], undone[1], undone[2], undone[3], undone[4], undone[5] = p0, p1, p2, v0, v1, v2


@njit(cache=True)
def listen(undone, mem, dims, places, nav, C, x, kind, mount, ring, cursor, ticks):
    """After a reading: note its open-loop residual in `ring` (kind != 0), then add what it fed back to `undone`.

    mem, dims, places: the channel's memory as the correction left it (see ``kalman.places``). C (a, errors), x: output rows and block means.
    mount: (9,) body to instrument, row by row. ring: (a, capacity); cursor: (1,) ticks written so far; `ticks` of the sensor's clock have
    passed since the reading before (those without a reading are noted as NaN). undone: (m + 3 + m - 9,), the end is work space.
    """
    a, m, start, errors = dims[0], dims[2], dims[4], dims[5]
    K, res, verdict = places[1], places[3], places[8]
    used = mem[verdict + 2] != 0.0
    if kind != NOTHING:
        capacity = ring.shape[1]
        at = cursor[0]
        for _ in range(min(ticks - 1, capacity)):
            for i in range(a):
                ring[i, at % capacity] = math.nan
            at += 1
        near = places[7]
        width = (places[8] - places[7]) // a
        for i in range(a):
            y = math.nan
            if used:
                # the residual as it was before the sensor's own coloured error was taken off
                y = mem[verdict + 3 + i]
                for j in range(errors):
                    back = 0.0
                    for r in range(a):
                        back += mem[K + (start + j) * a + r] * mem[res + r]
                    y += C[i, j] * (x[start - 9 + j] - back)
                if kind == HEADING:
                    y += undone[8]
                elif kind == POSITION:
                    for j in range(6):
                        y += mem[near + i * width + j] * undone[j]
                else:
                    for j in range(3):
                        y += mount[3 * i + j] * undone[m + j]
            ring[i, at % capacity] = y
        cursor[0] = at + 1
    if not used:
        return
    d = mem[places[9] : places[9] + m]
    for i in range(m):
        d[i] = 0.0
        for r in range(a):
            d[i] += mem[K + i * a + r] * mem[res + r]
        if i < 6 or i >= 8:
            undone[i] += d[i]
    u, v, w = nav[3], nav[4], nav[5]
    e, f, g = d[3] + v * d[8] - w * d[7], d[4] + w * d[6] - u * d[8], d[5] + u * d[7] - v * d[6]
    for j in range(3):
        undone[m + j] += nav[6 + j] * e + nav[9 + j] * f + nav[12 + j] * g
