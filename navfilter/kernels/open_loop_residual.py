"""Kernels that take the filter's own feedback off again, so that a sensor's error can be learnt from its readings.

``undone`` holds the sum of what corrections fed back, carried along as an open loop would have carried it, but frozen
at the time of the correction into chains of plain integrators: heading by the drive's states; position and velocity in
n by the acceleration in n; velocity in b by the acceleration in b. An open loop would read higher residuals by H times
that sum. What is left beside it is the error of the closed loop, which is small, so that Coriolis force, turns and a
pitching accelerometer bias act on that small error only, not on the sum.

A force that is found wrong while the vehicle pitches or rolls was wrong in another direction before: there the drift is
no chain of integrators. How much of the downward force fed back came by that is summed up, and noted beside the
residuals.

A residual is that of the sensor's constants (scale, lever arm, clock ...) as they are estimated at the time. Where some
are states, their estimates and the slopes of the reading by them are noted, too, so that residuals can be those of
better estimates later.

Places in ``undone`` (2m + 3 elements for m head states): position 0-2, velocity 3-5, heading 8, the drive's states 9 to
m, then velocity in b, acceleration in n, acceleration in b (three each), and m - 9 of work space; then that sum,
and last how well fixes were predicted that nothing is learnt from, and how well readings with constants as states.
"""

import math

from navfilter.kernels.compiling.decorators import UNCOUNTED, njit, shaped

NOTHING, HEADING, POSITION, VELOCITY = 0, 1, 2, 3
# An `ear`, what is listened with to one channel over many readings: kind of its open loop, ticks noted and capacity of
# its ring, ticks by which there is something to do; by which factor its level must differ to be another one (0: it is
# not watched), the level in force, the probability of each of `LEVELS`; elements of `mount`.
KIND, NOTED, CAPACITY, DUE, ANOTHER, LEVEL, ODDS = range(7)
# An error may be so many times as large as its model, as a variance [1]: by twos, up to eight times the sd.
LEVELS = (1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0)
LOG_LEVELS = tuple(math.log(level) for level in LEVELS)
MOUNT = ODDS + len(LEVELS)
# First in a `mount`, before the rows that turn the body's axes to the instrument's: a velocity below which nothing is
# learnt [m/s], how long a reading waits [s], which of the sensor's parameters is its clock (-1: none), rows of the
# ring; where it is summed up how well its readings are predicted (0: nowhere).
STILL, LEAD_S, CLOCK, ROWS, ASKED, AXES = range(6)
EAR = MOUNT + AXES + 9
OF_FIXES, BESIDE_CONSTANTS = 1.0, 2.0  # `ASKED` of the two sums that `undone` ends with
# The level changes from one reading to the next with this probability [1]: in 50 minutes at 8 Hz. Ten times as often,
# it is changed four times as often, and errors are the same.
CHANGES = 4e-5
# Where levels are told apart, a single reading counts up to this NIS [1], or a spike would be another level for a
# moment: by chi-square of 1 to 6 components as improbable as three standard deviations of one. `NIS_MOST` is the same
# where fixes are judged [1].
MOST, NIS_MOST = (9.0, 11.83, 14.16, 16.25, 18.21, 20.06), 25.0


@njit(cache=True, **UNCOUNTED)
def _is_another(ear):
    """Whether the mean level is another one than that in force."""
    mean = 0.0
    for k in range(len(LEVELS)):
        mean += ear[ODDS + k] * LEVELS[k]
    return mean > ear[ANOTHER] * ear[LEVEL] or mean * ear[ANOTHER] < ear[LEVEL]


@njit(apart=True, cache=True, **UNCOUNTED)
def judge_level(ear, nis, dof):
    """Bayes' rule for the probabilities of the levels, of which any may follow: innovations have a covariance that goes
    as the level.
    """
    largest, total = -math.inf, 0.0
    seen = ear[LEVEL] * min(nis, MOST[min(int(dof), len(MOST)) - 1])
    for k in range(len(LEVELS)):
        largest = max(largest, -0.5 * (dof * LOG_LEVELS[k] + seen / LEVELS[k]))
    for k in range(len(LEVELS)):
        before = (1.0 - CHANGES) * ear[ODDS + k] + CHANGES / len(LEVELS)
        ear[ODDS + k] = before * math.exp(-0.5 * (dof * LOG_LEVELS[k] + seen / LEVELS[k]) - largest)
        total += ear[ODDS + k]
    for k in range(len(LEVELS)):
        ear[ODDS + k] /= total


@njit(apart=True, cache=True, **UNCOUNTED)
def after_reading(ear, nis, dof, ticks, learning):
    """After a reading: count its ticks and, where it is time for learning, see how it fared; True when the error has
    another level, or enough ticks have been noted.
    """
    ear[NOTED] += 1.0 + min(max(ticks - 1.0, 0.0), ear[CAPACITY])
    if not learning:
        return False
    if ear[ANOTHER] != 0.0 and dof > 0.0 and math.isfinite(nis):
        judge_level(ear, nis, dof)
        if _is_another(ear):
            return True
    return ear[NOTED] >= ear[DUE]


@njit(apart=True, cache=True, **UNCOUNTED)
def carry_feedback(undone, Phi):
    """Carry the sum over a compound transition Phi (m x m), which says how long it took and how the drive's states turn
    the heading.
    """
    m = Phi.shape[0]
    dt = Phi[0, 3]
    for i in range(3):
        undone[i] += dt * (undone[3 + i] + 0.5 * dt * undone[m + 3 + i])
        undone[3 + i] += dt * undone[m + 3 + i]
        undone[m + i] += dt * undone[m + 6 + i]
    for j in range(9, m):
        undone[8] += Phi[8, j] * undone[j]
    for i in range(9, m):
        s = 0.0
        for j in range(9, m):
            s += Phi[i, j] * undone[j]
        undone[m + i] = s
    for i in range(9, m):
        undone[i] = undone[m + i]


@njit(cache=True, **UNCOUNTED)
def _in_body(mem, nav, K, res, a, used, axis):
    """A component of the velocity in b, as it was before the correction."""
    v = 0.0
    for i in range(3):
        back = 0.0
        if used:
            for r in range(a):
                back += mem[K + (3 + i) * a + r] * mem[res + r]
        v += nav[6 + 3 * i + axis] * (nav[3 + i] - back)
    return v


@njit(apart=True, cache=True, **UNCOUNTED)
def record_residual(undone, mem, dims, places, nav, C, x, kind, mount, ring, cursor, ticks, Cr, gravity):
    """After a reading: carry `undone` to it, note its open-loop residual in `ring` (kind != 0), then add what it fed
    back.

    mem, dims, places: the channel's memory as the correction left it (see ``kalman.memory_offsets``). C (a, errors), x:
    output rows and means. mount: see `STILL`, then body to instrument, row by row. ring: (a + 1, capacity), the last
    row for the force that came by pitch and roll [m/s^2]; where constants are noted, as many rows of their estimates
    follow, and of the slopes of each axis by them. cursor: (1,) ticks written so far; `ticks` of the sensor's clock
    have passed since the reading before (those without a reading are noted as NaN). Cr: (6, drive's states + 1), the
    drive's output rows, forces last; gravity: what a tilt turns into acceleration, 0 without an inertial unit, whose
    velocity is no integral.

    A velocity that stands still is noted as missing. A reading that waits tells the state of `LEAD_S` and of its
    clock's offset earlier, and so does what is put in again.
    """
    a, m, start, errors, par = dims[0], dims[2], dims[4], dims[5], dims[6]
    K, res, verdict = places[1], places[3], places[8]
    carry_feedback(undone, shaped(mem[: m * m], m, m))
    used = mem[verdict + 2] != 0.0
    if mount[ASKED] != 0.0:
        for i in range(a):
            variance = mem[verdict + 3 + a + i]
            if variance > 0.0:
                # as likely as a normal variate; of one that is far off only so much counts
                off = mem[verdict + 3 + i] ** 2 / variance
                undone[2 * m + int(mount[ASKED])] -= 0.5 * (min(off, NIS_MOST) + math.log(variance))
    if kind != NOTHING:
        capacity = ring.shape[1]
        at = cursor[0]
        for _ in range(min(ticks - 1, capacity)):
            for i in range(ring.shape[0]):
                ring[i, at % capacity] = math.nan
            at += 1
        near, late_s, read = places[7], mount[LEAD_S], 0.0
        if ring.shape[0] > a + 1:
            for p in range(par):
                now = x[start - 9 + errors + p]
                if used:
                    for r in range(a):
                        now -= mem[K + (start + errors + p) * a + r] * mem[res + r]
                ring[a + 1 + p, at % capacity] = now
                if p == mount[CLOCK]:
                    late_s += now
                for i in range(a):
                    ring[a + 1 + (1 + i) * par + p, at % capacity] = mem[near + i * (9 + par) + 9 + p]
        width = (places[8] - places[7]) // a
        for i in range(a):
            # the residual as it was before the sensor's own coloured error was taken off; also of a reading that the
            # gate rejected, or what is believed of the sensor would choose what is learnt of it
            y = mem[verdict + 3 + i]
            for j in range(errors):
                back = 0.0
                if used:
                    for r in range(a):
                        back += mem[K + (start + j) * a + r] * mem[res + r]
                y += C[i, j] * (x[start - 9 + j] - back)
            if kind == HEADING:
                y += undone[8]
            elif kind == POSITION:
                for j in range(3):
                    gone = late_s * (undone[3 + j] - 0.5 * late_s * undone[m + 3 + j])
                    y += mem[near + i * width + j] * (undone[j] - gone)
            else:
                z = y
                for j in range(3):
                    by = mount[AXES + 3 * i + j]
                    y += by * (undone[m + j] - late_s * undone[m + 6 + j])
                    if mount[STILL] > 0.0:
                        z += by * _in_body(mem, nav, K, res, a, used, j)
                read += z * z
            ring[i, at % capacity] = y
        if kind == VELOCITY and read < mount[STILL] * mount[STILL]:
            for i in range(a):
                ring[i, at % capacity] = math.nan
        ring[a, at % capacity] = undone[2 * m]
        cursor[0] = at + 1
    if not used:
        return
    d = mem[places[9] : places[9] + m]
    for i in range(m):
        d[i] = 0.0
        for r in range(a):
            d[i] += mem[K + i * a + r] * mem[res + r]
        if i < 3 or i >= 8 or (i < 6 and gravity > 0.0):
            undone[i] += d[i]
    u, v, w = nav[3], nav[4], nav[5]
    e, f, g = d[3] + v * d[8] - w * d[7], d[4] + w * d[6] - u * d[8], d[5] + u * d[7] - v * d[6]
    # tilt acts in n; in b it turns with the heading alone: pitch and roll come and go, what was fed back stays
    north, east = -gravity * d[7], gravity * d[6]
    level = math.sqrt(nav[6] ** 2 + nav[9] ** 2)
    c, s = (nav[6] / level, nav[9] / level) if level > 0.0 else (1.0, 0.0)
    n, b = m + 3, m + 6
    undone[n] += north
    undone[n + 1] += east
    undone[b] += c * north + s * east
    undone[b + 1] += c * east - s * north
    for j in range(3):
        undone[m + j] += nav[6 + j] * e + nav[9 + j] * f + nav[12 + j] * g
        if gravity > 0.0:
            force = 0.0
            for i in range(9, m):
                force -= Cr[3 + j, i - 9] * d[i]
            undone[b + j] += force
            undone[2 * m] += (nav[12 + j] - (1.0 if j == 2 else 0.0)) * force
            for i in range(3):
                undone[n + i] += nav[6 + 3 * i + j] * force
