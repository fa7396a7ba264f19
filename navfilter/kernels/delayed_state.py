"""Readings of a sensor whose place or clock is not known for certain: how the vehicle has moved of late, and what the
sensor would have read then.
"""

import math

import numpy as np

from navfilter.kernels import consistency, measurement, strapdown
from navfilter.kernels.compiling import addresses
from navfilter.kernels.compiling.decorators import UNCOUNTED, flat, njit, scratch, shaped
from navfilter.kernels.compiling.registers import LANES, all_of, eight, load, put, store, times

#: Slopes are means over this time at least: what is faster, a car on its springs or noise, tells no clock [s].
SLOPE_S = 1.0
#: And over so many standard deviations of the clock: between the outer two of three Gauss-Hermite points [1].
SPREAD = 2.0 * math.sqrt(3.0)
#: What of a slope is left out stays so as long as a vehicle turns [s], and has as white noise the power of so many
#: readings. A receiver's velocity whose error lasts for 3 s had its clock taken for none, at a sd of 7 ms, 50 to 210 ms
#: off; mean squares over random vehicles are 1.7, by 1 s 2.2, by single readings 2.8 (DVL beams 4.0, 5.2, 5.3).
LEFT_S = 4.0
#: Step of the difference quotients over lever arm [m] and time [s]; a reading is linear in both, or nearly so.
STEP = 1e-3
#: So much more of the past is kept than the clock may be off: half of what a slope is taken over [s].
MORE_S = 0.5
#: Elements of what `delayed_reading` works in, but for those whose number the sensor says.
ROOM = 149
#: Elements of `facts` of a sensor: whether its lever arm is a state, and its clock; whether it turns with the body; how
#: many readings share what is left of a slope; from BY_ARM on what a lever arm does to its constants, row by row
#: (constants, 3).
ARM, CLOCK, TURNS, SHARED, BY_ARM = range(5)


@njit(apart=True, cache=True, **UNCOUNTED)
def drive_outputs(drv, Cr, xd, rows, errors):
    """Rows (6, k) by which the drive's states make the errors of its six values now, and these errors (6,).

    Those of its error models are in `Cr`; scale and misalignment act on the last sample, as if it had no errors.
    """
    k, elements = len(xd), int(drv[strapdown.CALIBRATED])
    per = drv[strapdown.PERIOD_S] if drv[strapdown.INCREMENTS] != 0.0 else 1.0
    whole = flat(rows)
    for i in range(whole.size):
        whole[i] = 0.0
    for i in range(6):
        s = 0.0
        for j in range(k - elements):
            if Cr[i, j] != 0.0:
                rows[i, j] = Cr[i, j]
                s += Cr[i, j] * xd[j]
        errors[i] = s
    for q in range(elements):
        element, j = int(drv[strapdown.ELEMENTS + q]), k - elements + q
        channel = strapdown.OF_READING[element]
        rows[channel, j] = drv[strapdown.PREVIOUS + strapdown.BY_AXIS[element]] / per
        errors[channel] += rows[channel, j] * xd[j]


@njit(cache=True, inline="always")
def _without_errors(felt, last, errors, work):
    """An interval of `inertial_motion` without errors: those of the last sample, and by how much this one errs
    otherwise, as the unit is not calibrated. work: an interval, then six columns of M.
    """
    store(work, 0, felt - last)
    for j in range(6):
        errors = errors + times(load(work, 1 + j), all_of(work[0, 2 + j]))
    return felt - errors


@njit(cache=True, **UNCOUNTED)
def inertial_motion(recent, nav, drv, errors, rows, gravity):
    """Rates and forces of an inertial unit by the trapezoidal rule; the last sample holds since.

    recent (k, 7): the last samples, the newest first, see `navfilter.filter.filter_memory`; errors (6,) of the last
    one. Fills rows (k + 1, 7), intervals, the newest first: seconds (0: nothing known), angular rate and specific
    force in b; and gravity (1,), 0 where the forces are accelerations.
    """
    k, steps = recent.shape[0], drv[strapdown.INCREMENTS] != 0.0
    per = drv[strapdown.PERIOD_S] if steps else 1.0
    # eight numbers: the last of the interval before, seconds, rates and forces
    work, of, to = scratch(np.float64, int(10), LANES), flat(recent), flat(rows)
    for i in range(10):
        store(work, i, all_of(0.0))
    for c in (0, 3):
        for i in range(3):
            for j in range(3):
                work[1 + c + j, 2 + c + i] = drv[strapdown.CALIBRATION + 3 * (c + i) + j]
    for j in range(6):
        work[7, 2 + j], work[8, 2 + j] = drv[strapdown.PREVIOUS + j] / per, errors[j]
    last, wrong = load(work, 7), load(work, 8)
    for i in range(k - 1, -1, -1):
        if i == 0:
            for j in range(7):
                work[9, 1 + j] = recent[0, j]
        felt = eight(of, 7 * i - 1) if i > 0 else load(work, 9)
        if steps:
            felt = felt / all_of(recent[i, 0] if recent[i, 0] > 0.0 else 1.0)
        elif i + 1 < k and recent[i + 1, 0] > 0.0:
            felt = all_of(0.5) * (felt + eight(of, 7 * i + 6))
        put(to, 7 * i + 6, _without_errors(felt, last, wrong, work))
        rows[1 + i, 0] = recent[i, 0]
    store(work, 9, _without_errors(last, last, wrong, work))
    rows[0, 0] = drv[strapdown.HELD_S]
    for j in range(6):
        rows[0, 1 + j] = work[9, 2 + j]
    gravity[0] = strapdown.gravity(nav[0], nav[2])


@njit(cache=True)
def dead_reckoning_motion(recent, nav, drv, errors, rows, gravity):
    """As `inertial_motion`, of dead reckoning: turns and changes of the velocity from reading to reading; before
    them the newest goes on, and since what is held. The forces are accelerations.
    """
    for i in range(rows.shape[0]):
        for j in range(7):
            rows[i, j] = 0.0
    gravity[0] = 0.0
    count = 0
    for i in range(recent.shape[0]):
        count += recent[i, 0] != 0.0
    M, u, gained = drv[strapdown.MOUNTING : strapdown.MOUNTING + 9], np.empty(3), np.empty(3)
    for i in range(3):
        u[i] = nav[6 + i] * nav[3] + nav[9 + i] * nav[4] + nav[12 + i] * nav[5]
    for i in range(count - 1):
        now, before, row = recent[i], recent[i + 1], rows[1 + i]
        for j in range(3):
            angle = now[1 + j] - before[1 + j] + math.pi
            row[1 + j] = angle - 2.0 * math.pi * math.floor(angle / (2.0 * math.pi)) - math.pi
            gained[j] = 0.0
            for r in range(3):
                gained[j] += M[3 * j + r] * (now[4 + r] - before[4 + r])
            if not abs(gained[j]) <= drv[strapdown.MAX_SPEED]:
                gained[j] = 0.0
        roll, pitch, yaw = row[1], row[2], row[3]
        sr, cr, sp, cp = math.sin(now[1]), math.cos(now[1]), math.sin(now[2]), math.cos(now[2])
        x, y, z = roll - yaw * sp, pitch * cr + yaw * sr * cp, yaw * cr * cp - pitch * sr
        row[0] = now[0]
        row[1], row[2], row[3] = x / now[0], y / now[0], z / now[0]
        row[4] = row[2] * u[2] - row[3] * u[1] + gained[0] / now[0]
        row[5] = row[3] * u[0] - row[1] * u[2] + gained[1] / now[0]
        row[6] = row[1] * u[1] - row[2] * u[0] + gained[2] / now[0]
    if count > 1:
        rows[0, 0] = drv[strapdown.HELD_S]
        x, y, z = drv[strapdown.TURNING], drv[strapdown.TURNING + 1], drv[strapdown.TURNING + 2]
        rows[0, 1], rows[0, 2], rows[0, 3] = x, y, z
        rows[0, 4] = y * u[2] - z * u[1] + drv[strapdown.GAINING]
        rows[0, 5] = z * u[0] - x * u[2] + drv[strapdown.GAINING + 1]
        rows[0, 6] = x * u[1] - y * u[0] + drv[strapdown.GAINING + 2]


@njit(cache=True, **UNCOUNTED)
def _by_drive(now, then, B, late_s, outputs, u, row):
    """What errors of rates and forces do to a reading through a state that is carried back by them, into row (k,),
    by the drive's states; u: derivative of the reading by that state. `B` holds what the forces have gathered
    (`measurement.earlier`).
    """
    for s in range(len(row)):
        row[s] = 0.0
    for j in range(3):
        by_rate, by_force = 0.0, 0.0
        for i in range(3):
            # a tilt that grows on the way back turns the forces: half of what the whole of it would do, a third to
            # the place
            pushed, turned = late_s * u[3 + i] - 0.5 * late_s * late_s * u[i], late_s * u[6 + i]
            for r in range(3):
                turned += (0.5 * late_s * u[3 + r] - late_s * late_s / 6.0 * u[r]) * B[3 + r, 6 + i]
            middle = 0.5 * (now[6 + 3 * i + j] + then[6 + 3 * i + j])
            by_rate, by_force = by_rate + turned * middle, by_force + pushed * middle
        for s in range(len(row)):
            row[s] += by_rate * outputs[j, s] + by_force * outputs[3 + j, s]


@njit(cache=True, **UNCOUNTED)
def slope_window_s(variance):
    """Over what time the slope of a reading is taken whose clock has this variance [s]."""
    return max(SLOPE_S, SPREAD * math.sqrt(variance))


@njit(cache=True, **UNCOUNTED)
def mean_rate(rows, rate):
    """Mean of the angular rate (3,) over `consistency.WINDOW_S`, of the intervals but for the newest two: those have
    the noise of the reading that is predicted. rows: see `inertial_motion`.
    """
    seconds = 0.0
    for j in range(3):
        rate[j] = 0.0
    for i in range(2, rows.shape[0]):
        if rows[i, 0] <= 0.0 or seconds >= consistency.WINDOW_S:
            break
        seconds += rows[i, 0]
        for j in range(3):
            rate[j] += rows[i, 0] * rows[i, 1 + j]
    for j in range(3):
        rate[j] /= max(seconds, 1e-9)


@njit(cache=True, **UNCOUNTED)
def register_room(count):
    """So many numbers are as many registers of eight: their elements."""
    return (count + LANES - 1) // LANES * LANES


@njit(cache=True, **UNCOUNTED)
def _samples_needed(recent, late_s, long_s):
    """How many of the drive's last samples `measurement.earlier` and `mean_rate` ask for, with the one that the oldest
    of them is a mean with.
    """
    most = recent.shape[0]
    over_s = min(long_s, max(2.0 * late_s, consistency.WINDOW_S))
    reach_s, count, age_s = max(late_s, 0.5 * over_s) + 0.5 * over_s, 1, 0.0
    while count < most and age_s < reach_s:
        age_s += max(recent[count, 0], 0.0)
        count += 1
    return min(count + 1, most)


@njit(apart=True, cache=True, **UNCOUNTED)
def _delayed_reading(given, H, near, res, R, work):
    """As `delayed_reading`; given: what it is told; work: what it has room in."""
    equation, motion, facts, z, nav, rate, par, cfg, recent, drv, Cr, xd, since_s, variance, pushes = given
    arm, clock = facts[ARM] != 0.0, facts[CLOCK] != 0.0
    a, last = near.shape[0], near.shape[1] - 10
    own = last + 1 - (3 if arm else 0) - (1 if clock else 0)
    kind, k = par[:own], len(xd)
    then, turn, gravity, errors = work[:17], work[17:23], work[23:24], work[24:30]
    slope, B, told = shaped(work[30:48], 2, 9), shaped(work[48:129], 9, 9), work[129:132]
    steady, work = work[132:149], work[ROOM:]
    constants, moved, work = work[: len(cfg)], work[len(cfg) : 2 * len(cfg)], work[2 * len(cfg) :]
    outputs, work = shaped(work[: 6 * k], 6, k), work[6 * k :]
    ends, base, whole, work = work[:a], work[a : 2 * a], work[2 * a : 2 * a + z.size], work[2 * a + z.size :]
    inner, work = shaped(work[: a * (9 + own)], a, 9 + own), work[a * (9 + own) :]
    missing = False
    for i in range(z.size):
        # what is not read has slopes, too: by how much it is known is asked, see `consistency.limit_unread_slopes`
        missing |= math.isnan(z[i])
        whole[i] = 0.0 if math.isnan(z[i]) else z[i]
    for i in range(len(cfg)):
        constants[i] = cfg[i]
        if arm:
            for j in range(3):
                constants[i] += facts[BY_ARM + 3 * i + j] * par[own + j]
    seen, turning, over_s = nav, rate, 0.0
    drive_outputs(drv, Cr, xd, outputs, errors)
    long_s = slope_window_s(variance) if clock else 2.0 * consistency.WINDOW_S
    late_s = since_s + par[last] if clock else 0.0
    known = _samples_needed(recent, late_s, long_s)
    rows = shaped(work[: 7 * (known + 1)], known + 1, 7)
    addresses.at_motion(motion, (recent[:known], nav, drv, errors, rows, gravity))
    if clock:
        over_s = measurement.earlier(nav, rows, gravity[0], late_s, consistency.WINDOW_S, long_s, then, turn, slope, B)
        seen, turning = then, turn[:3]
    addresses.at_equation(equation, (z, seen, turning, kind, constants, inner, res))
    for i in range(a):
        for j in range(9 + own):
            near[i, j] = inner[i, j]
    if clock:
        for i in range(a):
            u, told_by_clock = inner[i], 0.0
            for j in range(9):
                told_by_clock -= u[j] * slope[0, j]
            near[i, 9 + last] = told_by_clock
            for j in range(3):
                near[i, 3 + j] += u[j] * B[j, 3 + j]
                for r in range(6):
                    near[i, 6 + j] += u[r] * B[r, 6 + j]
            if gravity[0] != 0.0:
                _by_drive(nav, then, B, late_s, outputs, u, H[i][9 : 9 + k])
    if arm:
        for j in range(3):
            told[j] = turn[j]
        if not clock:
            mean_rate(rows, told)
        if drv[strapdown.INERTIAL] == 0.0:
            # the attitude is a reading: what it errs by is in the position, too, see `strapdown._steady`
            for j in range(17):
                steady[j] = drv[strapdown.STEADY_C + j - 6] if 6 <= j < 15 else seen[j]
        else:
            steady = seen
        addresses.at_equation(equation, (whole, steady, told, kind, constants, inner, base))
        # what a mounting or a scale does with the arm's turning: the noise of the rate is in the residual, too
        for i in range(a):
            for j in range(9, 9 + own):
                near[i, j] = inner[i, j]
        for j in range(3):
            for i in range(len(cfg)):
                moved[i] = constants[i] + STEP * facts[BY_ARM + 3 * i + j]
            addresses.at_equation(equation, (whole, steady, told, kind, moved, inner, ends))
            for i in range(a):
                near[i, 9 + own + j] = (base[i] - ends[i]) / STEP
    if clock and facts[TURNS] != 0.0:
        for i in range(a):
            base[i] = res[i]
        if missing:
            addresses.at_equation(equation, (whole, seen, turning, kind, constants, inner, base))
        for i in range(3):
            turn[i] += STEP * turn[3 + i]
        addresses.at_equation(equation, (whole, seen, turning, kind, constants, inner, ends))
        for i in range(a):
            near[i, 9 + last] -= (base[i] - ends[i]) / STEP
    if clock:
        consistency.discount_clock(
            inner, slope, then, drv, Cr, over_s, gravity[0], variance, pushes, facts[SHARED], near, R
        )


@njit(cache=True, **UNCOUNTED)
def delayed_reading(
    equation, motion, facts, z, nav, rate, par, cfg, recent, drv, Cr, xd, since_s, variance, pushes, H, near, res, R
):
    """Residual and Jacobian of a reading of any kind through its own kernel, with a lever arm and a clock that are
    states: the last of `par`.

    A time offset moves the state at which the kernel is asked: to that of `time_offset` earlier. So the derivative
    with respect to it is minus that of the reading with time, as the drive felt it then.

    equation, motion: addresses of the sensor's kernel and of `inertial_motion` or `dead_reckoning_motion`; facts: of
    the sensor, see at the head of this file; z, nav, rate, cfg: as for `navfilter.kernels.measurement`; recent: the
    drive's last samples; since_s: how much later than the stamp it is now; variance: of the clock; pushes (3, 3): see
    `consistency.acceleration_covariance`. H (a, n) receives the derivatives with respect to the drive's states (a bias
    bends the way back); near and res are filled as by the kernel; R (a, a) grows by what the clock's error does beyond
    that.
    """
    sizes = 7 * (recent.shape[0] + 1) + near.size + 2 * len(res) + len(z) + 2 * len(cfg) + 6 * len(xd)
    work = flat(scratch(np.float64, int(1), ROOM + sizes))
    given = equation, motion, facts, z, nav, rate, par, cfg, recent, drv, Cr, xd, since_s, variance, pushes
    _delayed_reading(given, H, near, res, R, work)
