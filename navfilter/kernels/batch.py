"""Kernels that go through many readings at once: what `Filter` does reading by reading, in the same order, by the same
kernels, so that both come to the same bits.
"""

import math

import numpy as np

from navfilter.kernels import (
    consistency,
    delayed_state,
    fault_bank,
    imu_checks,
    kalman,
    noise_scale,
    open_loop_residual,
    strapdown,
    symmetric,
)
from navfilter.kernels.compiling import addresses
from navfilter.kernels.compiling.decorators import UNCOUNTED, flat, njit, scratch, shaped, standing

# What is beyond belief is so many times the variance [1], see `navfilter.faults.bias_plausibility`.
BELIEVED = 16.0
# A heading that is further off is beyond what is linear: by an eighth, half its square. [rad] (derived)
LINEAR_RAD = 0.5
# Times that differ by less are the same [s].
SAME_S = 1e-7
# Beyond this variance of the heading [rad^2] a body velocity is taken with its second-order term.
UNSURE_HEADING = 0.01

# Columns of `plan`, a row a channel: the eight of `kalman.update`; addresses of its kernel (0: it is asked by Python),
# of `delayed_state.delayed_reading` where its place or clock is a state, of the drive's motion for that, and of what
# its equation bends by (0: none); whether it moves, turns, and reads the drive's own rates; then where in `bench` its
# parts stand: working memory, constants and how many, rate, model, C, white, lever, R, limits, facts; in the working
# memory the verdict, and how long the record for the smoother is; whether a reading of which components are left out is
# Python's to judge; from which of its parameters to which the slopes are held; which of its axes is the heading (-1:
# none); whether these parameters may be hidden by the state's error; whether nobody wants to know its transitions;
# where the table of its fault states stands (0: none), see `fault_states`; the first row of the same instrument, and
# where the bank of faults stands (0: none), see `fault_bank`. One more row is for the drive: dimensions of
# a fold, addresses of its steps, its hold and `correction` in the first three, in MEM its work space, in RECORD the
# longest record of all.
EQUATION, SIGHT, MOTION, BEND, MOVES, TURNS, READS_RATE = range(8, 15)
STEPS, HOLD, CORRECTION = EQUATION, SIGHT, MOTION
MEM, CONSTANTS, CONSTANTS_SIZE, RATE, MODEL, OUTPUT, WHITE, LEVER_NOISE, NOISE, LIMITS, FACTS = range(15, 26)
VERDICT, RECORD, PARTLY, HELD, HELD_TO, NORTH, HIDDEN, UNHEARD, FAULTS, INDEX, BANK, PLAN = range(26, 38)

# Elements of `now`: time of the state and of the last sample, stamp of the last sample, time of the last row written;
# what faults that nobody has noticed may have done, see `fault_bank`.
TIME_S, SAMPLE_S, BEFORE_S, ROW_S, UNNOTICED = range(5)
# Elements of `cursor`: reading, sample, samples whose transition is not in P yet, gaps, rows written, records written,
# elements of them; samples that are steps already; one spare; where in `recent` the newest sample of the drive stands.
READING, SAMPLE, UNFOLDED, GAPS, ROWS, RECORDS, WRITTEN, STEPPED, SPARE, NEWEST, CURSOR = range(11)
# The drive's last samples stand in an array that is longer by so many rows: they move once in as many samples.
MORE_RECENT = 512
# Elements of `settings`: period of the drive, how far ahead a reading may be, samples between folds, silence that is a
# gap, silence that is in doubt, when something is due, interval of the rows; whether samples are increments; from when
# on it is learnt from readings, and what a tilt turns into acceleration (see `record_residual`); after how many samples
# Python feels whether the vehicle rests (0: never); when slow faults are looked for.
PERIOD_S, AHEAD_S, FOLD_EVERY, GAP_S, DOUBT_S, UNTIL_S, INTERVAL_S, INCREMENTS, LEARN_S, GRAVITY, FELT = range(11)
LOOK_S = 11
# Columns of `heard`, a row a channel: period, until when readings are the kernel's though some have been refused, ticks
# of the last reading, how long readings wait.
CHANNEL_PERIOD_S, USUAL_S, TICKS, WAIT_S = range(4)
# What stands behind the verdict of a channel, which has 3 + 2a elements: when it was read, ticked and used last; for
# how many ticks its coloured error may have been beyond one sd.
LAST_S, TICKED_S, TAKEN_S, LET_GO, NOTED = range(5)
# Columns of `watched`, a row a channel: equal values in a row, since when, heard last, used last, running NIS, most
# components that one had, the last that had so many, how many have been used, and where the last of them was.
SAME, SINCE_S, HEARD_S, USED_S, NIS, MOST, WHOLE_S, USED, LATITUDE, LONGITUDE, FIGURES = range(11)
# Readings of the running NIS, and what a single one counts per component at most: an outlier is no noise, and five of
# them bring the mean beyond the 3 of a noisy sensor. Two do not, of one whose mean is 1.8 as it is. It begins with 1.
NIS_MEMORY, NIS_MOST = 50.0, 25.0
# Slow faults are looked for so often [s].
LOOK_EVERY_S = 10.0
# The same value so many times and for so long is stuck, as `navfilter.faults.sensor_monitor.SensorMonitor` has it.
STUCK_READINGS, STUCK_S = 10.0, 8.0

# Elements of `facts`, of a channel whose readings come live: its place in `plan` and among the inputs that are kept;
# its period; up to which value readings are taken as they are; without a fix for how long its vehicle has dived; what a
# tilt turns into acceleration, and from when on it is learnt from readings (see `record_residual`); ticks of the last
# reading.
CHANNEL, KEPT_AS, TICK_S, LARGEST, DIVE_S, TILTED, LEARNT_S, TICKED, FACTS_SIZE = range(9)
# So many arrays are handed to `correct_reading`, and to `propagate_sample`, by where they stand; which of these is what
# is kept.
HAND, HELD_FOR_SAMPLES, PIECE = 19, 15, 13

# Why a stretch has ended: all is done; the next reading, or the samples before it, are for Python; its samples are
# taken, the reading is for Python; it was not used: Python says what follows; no room is left in the output; the watch
# over the drive has found something that Python has to heed; after the last reading there is something to learn, or a
# slow fault is believed.
DONE, NEXT, REFUSED, JUDGED, FULL, HEED, LEARN, LOOK = range(8)


@njit(apart=True, cache=True, **UNCOUNTED)
def _white(bench, spot, P, nav, variance, R):
    """The white covariance of a reading."""
    a = R.shape[0]
    own = variance.size > 0 and not math.isnan(variance[0])
    for i in range(a):
        for j in range(a):
            at = i * a + j
            R[i, j] = bench[spot[LEVER_NOISE] + at] if own else bench[spot[WHITE] + at]
        if own:
            R[i, i] += variance[i]
        if spot[MOVES] and P[8, 8] > UNSURE_HEADING:
            # second-order term of a velocity seen from a heading that is hardly known (Gelb, 1974, sec. 6.1)
            R[i, i] += 0.5 * (nav[3] ** 2 + nav[4] ** 2) * P[8, 8] ** 2


@njit(apart=True, cache=True, **UNCOUNTED)
def _corrected(bench, spot, P, nav, x, drv, Cr, C, R, moves, limits):
    """`kalman.update` by residual and Jacobian as they stand in working memory, and what keeps it consistent.

    C (a, errors), R (a, a): of the coloured and the white error; moves: it reads a whole velocity through the
    heading; limits: of the gate. What turns with the heading does so whatever the estimate becomes; constants that
    the state's error would tell too much of are held back.
    """
    dims = spot[:8]
    a, n, m, start, errors, parameters = dims[0], dims[1], dims[2], dims[4], dims[5], dims[6]
    mem = bench[spot[MEM] : spot[CONSTANTS]]
    places = kalman.memory_offsets(dims)
    timed = spot[SIGHT] != 0 and bench[spot[FACTS] + delayed_state.CLOCK] != 0.0
    H, spare = shaped(mem[places[0] : places[0] + a * n], a, n), mem[places[9] : places[10]]
    near, res = shaped(mem[places[7] : places[8]], a, 9 + parameters), mem[places[3] : places[3] + a]
    slopes = spot[HELD_TO] - spot[HELD]
    velocity = nav[3], nav[4], nav[5]
    turns = drv[strapdown.OWN] != 0.0 and consistency.turns_with_heading(P, nav[3], nav[4])
    # constants that may be told too much: a lever arm's, the sensor's own, the unit's
    has_arm = spot[SIGHT] != 0 and bench[spot[FACTS] + delayed_state.ARM] != 0.0
    by_arm, elements = parameters - 3 - int(timed), int(drv[strapdown.CALIBRATED])
    arm, hidden, unit = start + errors + by_arm, start + errors + spot[HELD], m - elements
    arm_kept = scratch(np.float64, int(4), delayed_state.register_room(int(3)))
    hidden_kept = scratch(np.float64, 1 + slopes, delayed_state.register_room(slopes))
    unit_kept = scratch(np.float64, 1 + elements, delayed_state.register_room(elements))
    if has_arm:
        consistency.store_constants(P, x, arm, arm_kept)
    if spot[HIDDEN]:
        consistency.store_constants(P, x, hidden, hidden_kept)
    if elements:
        consistency.store_constants(P, x, unit, unit_kept)
    kalman.update(P, nav, x, C, R, mem, dims, limits)
    change = mem[places[4] + 1 : places[5]]
    for i in range(5):
        change[i] = 0.0
    if mem[places[8] + 2] != 0.0:
        if moves:
            drv[strapdown.OWN] = 2.0 if dims[7] < 0 else 1.0
        if moves or turns:
            consistency.turn_velocity(P, nav, velocity, change)
            if dims[7] < 0:
                consistency.turn_current(P, shaped(mem[places[1] : places[2]], n, a), res, -dims[7])
        elif drv[strapdown.INERTIAL] != 0.0 and drv[strapdown.OWN] == 0.0:
            consistency.turn_tilts(P, shaped(mem[places[1] : places[2]], n, a), res, change[3:])
    if mem[places[8] + 2] != 0.0:
        K = shaped(mem[places[1] : places[2]], n, a)
        if has_arm:
            consistency.consider_lever_arm(P, x, near, arm_kept, by_arm, arm, drv, Cr, spare[:3])
        if spot[HIDDEN]:
            consistency.consider_hidden(P, x, H, K, hidden_kept, hidden, spare[:slopes])
        if elements:
            consistency.consider_unit(P, x, H, K, unit_kept, unit, spare[:elements], drv, Cr)


@njit(cache=True, **UNCOUNTED)
def readmission(bench, spot, P, nav, x, drv, Cr, C, R):
    """Correct by the residual and Jacobian of the reading that was refused last, without a gate."""
    a, mem = spot[0], bench[spot[MEM] : spot[CONSTANTS]]
    res, limits = mem[kalman.memory_offsets(spot[:8])[3] :], scratch(np.float64, int(1), a + 1)
    seen = 0
    for i in range(a):
        seen += math.isfinite(res[i])
    for i in range(a + 1):
        limits[0, i] = math.inf
    _corrected(bench, spot, P, nav, x, drv, Cr, C, R, spot[MOVES] != 0 and seen >= 3, flat(limits))
    if spot[BANK]:
        _note_faults(bench, spot, nav, math.inf, math.nan)


@njit(apart=True, cache=True, **UNCOUNTED)
def fault_states(table, z, nav, x, motion, start, north, C, near, res, held, band):
    """Let errors in proportion to the speed, those that go with the heading, the motion of what a velocity is read
    against, and a wrong lever arm or clock be those of a reading as foretold.

    table: how many of each there are; then, of each error in proportion, its state, the speed at which it is the
    error, and of how many axes; of each deviation its state and the heading at which it is the error; and of each
    motion, and each component of a description, its state, its component, and how many axes read it. motion (6,):
    angular rate and specific force in b. held (a,): the velocity by which an error in proportion was told last; it goes
    on within a band (`consistency.held_slope`). The residual of a heading comes within half a turn of its error.
    """
    scaled, deviating, flowing, described = int(table[0]), int(table[1]), int(table[2]), int(table[3])
    for j in range(scaled):
        state, at_m_s = int(table[4 + 3 * j]), table[5 + 3 * j]
        factor = 1.0 + x[start - 9 + state] / at_m_s
        for axis in range(int(table[6 + 3 * j])):
            predicted = z[axis] - res[axis]
            held[axis] = consistency.held_slope(0.0 if math.isnan(predicted) else predicted, held[axis], band)
            C[axis, state] = held[axis] / at_m_s
            for i in range(9):
                near[axis, i] *= factor
    for j in range(deviating):
        # its slope by the heading is left out: with it, turns would seem to tell a heading from the constant
        state, of_rad = int(table[4 + 3 * scaled + 2 * j]), table[5 + 3 * scaled + 2 * j]
        C[north, state] = math.cos(math.atan2(nav[9], nav[6]) - of_rad)
    for j in range(flowing):
        at = 4 + 3 * scaled + 2 * deviating + 3 * j
        state, component = int(table[at]), int(table[at + 1])
        for i in range(int(table[at + 2])):
            C[i, state] = -near[i, 3 + component]
    slope = flat(scratch(np.float64, int(1), 3))
    for j in range(described):
        at = 4 + 3 * scaled + 2 * deviating + 3 * flowing + 3 * j
        state, component = int(table[at]), int(table[at + 1])
        fault_bank.description_slope(component, nav, nav[3:6], motion, slope)
        for i in range(int(table[at + 2])):
            C[i, state] = near[i, 3] * slope[0] + near[i, 4] * slope[1] + near[i, 5] * slope[2]
    if north >= 0:
        error = 0.0
        for j in range(C.shape[1]):
            error += C[north, j] * x[start - 9 + j]
        res[north] = (res[north] - error + math.pi) % (2.0 * math.pi) - math.pi + error


@njit(cache=True, **UNCOUNTED)
def correction(bench, spot, P, nav, x, acc, drv, Cr, recent, z, variance, count, since_s):
    """A reading, from the fold before it to the verdict: `kalman.predict`, the kernel of its kind, `kalman.update`.

    bench: working memory of all channels; spot: this one's row of `plan`; recent: the drive's last samples, see
    `delayed_state.delayed_reading`; z: the reading as its kernel takes it; variance (a,) of its white error, empty or
    NaN for what the error model says; count: ticks of its clock; since_s: how much later than its stamp it is taken.
    Behind the limits of its gate stands which square of its coloured error, as estimated, is beyond belief: none is
    used. For how many ticks it may have been beyond one sd stands behind the verdict: from the last used reading within
    it.
    """
    dims = spot[:8]
    a, n, m, b, start, errors, parameters = dims[0], dims[1], dims[2], dims[3], dims[4], dims[5], dims[6]
    mem = bench[spot[MEM] : spot[CONSTANTS]]
    model = bench[spot[MODEL] : spot[MODEL] + 2 * b * b].reshape((2, b, b))
    places = kalman.memory_offsets(dims)
    if drv[strapdown.INERTIAL] == strapdown.FELT:
        consistency.attitude_second_order(P, acc, nav, drv[strapdown.OWN], mem[places[9] : places[10]])
    if not spot[UNHEARD]:
        kalman.store_transition(acc, mem)
    kalman.predict(P, nav, x, acc, model, mem, dims, count)
    motion, xd = bench[spot[RATE] : spot[RATE] + 6], x[: m - 9]
    rate = motion[:3]
    H, spare = shaped(mem[places[0] : places[0] + a * n], a, n), mem[places[9] : places[10]]
    timed = spot[SIGHT] != 0 and bench[spot[FACTS] + delayed_state.CLOCK] != 0.0
    # by a clock that is a state the rate is that of then
    if spot[READS_RATE] or (spot[TURNS] and (not timed or spot[FAULTS] or spot[BANK])):
        outputs, off = shaped(spare[: 6 * (m - 9)], 6, m - 9), spare[6 * (m - 9) : 6 * (m - 8)]
        delayed_state.drive_outputs(drv, Cr, xd, outputs, off)
        per = drv[strapdown.PERIOD_S] if drv[strapdown.INCREMENTS] != 0.0 else 1.0
        for i in range(6):
            motion[i] = drv[strapdown.PREVIOUS + i] / per - off[i]
        for i in range(3):
            if drv[strapdown.INERTIAL] == 0.0:
                rate[i] = drv[strapdown.RATE + i]
        if spot[READS_RATE]:
            own = spare[6 * (m - 8) : 6 * (m - 8) + z.size]
            for i in range(z.size):
                own[i] = z[i] - off[i] if i < 3 else z[i]
            z = own
            for i in range(3):
                for j in range(m - 9):
                    H[i, 9 + j] = outputs[i, j]
    near = shaped(mem[places[7] : places[8]], a, 9 + parameters)
    constants = bench[spot[CONSTANTS] : spot[CONSTANTS] + spot[CONSTANTS_SIZE]]
    first, res = start - 9 + errors, mem[places[3] : places[3] + a]
    R = shaped(bench[spot[NOISE] : spot[NOISE] + a * a], a, a)
    _white(bench, spot, P, nav, variance, R)
    par, slopes = x[first : first + parameters], spot[HELD_TO] - spot[HELD]
    held = shaped(spare[6 * (m - 8) + z.size :][: a * slopes], a, slopes)
    for i in range(a):
        for j in range(slopes):
            held[i, j] = near[i, 9 + spot[HELD] + j]
    if spot[SIGHT]:
        facts = bench[spot[FACTS] : spot[FACTS] + delayed_state.BY_ARM + 3 * spot[CONSTANTS_SIZE]]
        sensor = spot[EQUATION], spot[MOTION], facts
        here = z, nav, rate, par, constants, recent, drv, Cr, xd, since_s
        clock = start + errors + parameters - 1
        room = spare[6 * (m - 8) + z.size + a * slopes :]
        before = room[:a]
        for i in range(a):
            before[i] = near[i, 8 + parameters]
        room = room[a:]
        pushes = shaped(room[:9], 3, 3)
        if timed:
            consistency.acceleration_covariance(P, nav, drv, Cr, pushes, room[9 : 9 + 3 * (m - 6)])
        addresses.at_sight(spot[SIGHT], sensor + here + (P[clock, clock], pushes, H, near, res, R))
        if timed:
            consistency.limit_clock_slope(P, near, before, 8 + parameters)
    else:
        addresses.at_equation(spot[EQUATION], (z, nav, rate, par, constants, near, res))
    turned = 0.0
    for i in range(a):
        turned = max(turned, bench[spot[LEVER_NOISE] + i * a + i])
    if slopes:
        consistency.limit_velocity_slopes(P, near, held, spot[HELD], start + errors, turned)
    moves = spot[MOVES] != 0 and consistency.limit_unread_slopes(P, near, res, start + errors)
    C = shaped(bench[spot[OUTPUT] : spot[OUTPUT] + a * errors], a, errors)
    band, last = math.inf, places[7] - a
    if spot[FAULTS] or (spot[BANK] and spot[TURNS]):
        band = consistency.velocity_band(P, near, int(0), start + errors, turned)
    if spot[FAULTS]:
        shown = bench[spot[FAULTS] :], z, nav, x, motion, start
        fault_states(*shown, spot[NORTH], C, near, res, mem[last : last + a], band)
    if spot[BEND]:
        addresses.at_bend(spot[BEND], (z, near, P, start + errors, constants, R))
    limits, beyond, calm = bench[spot[LIMITS] : spot[LIMITS] + a + 1], False, True
    for i in range(a):
        error = 0.0
        for j in range(errors):
            error += C[i, j] * x[start - 9 + j]
        beyond |= error * error > bench[spot[LIMITS] + a + 1 + i]
        calm &= error * error <= bench[spot[LIMITS] + a + 1 + i] / BELIEVED
    let_go, used = places[8] + 3 + 2 * a + LET_GO, mem[places[8] + 2]
    mem[let_go] = count if calm and used else mem[let_go] + count
    if beyond:
        limits = spare[: a + 1]
        for i in range(a + 1):
            limits[i] = -1.0 if i else math.inf
    # by the reading itself a signature would be drawn to what explains it
    foretold = flat(scratch(np.float64, int(1), nav.size))
    symmetric.copy(nav, foretold)
    _corrected(bench, spot, P, nav, x, drv, Cr, C, R, moves, limits)
    if spot[BANK]:
        bank = bench[spot[BANK] :]
        fault_bank.carry(bank, shaped(mem[: m * m], m, m), int(0))
        if b > 0:
            fault_bank.carry(bank, shaped(mem[m * m : m * m + b * b], b, b), start)
        value = 0.0
        for i in range(min(a, z.size)):
            value += 0.0 if math.isnan(z[i]) else z[i]
        _note_faults(bench, spot, foretold, band, value)


@njit(apart=True, cache=True, **UNCOUNTED)
def _note_faults(bench, spot, nav, band, value):
    """Show the bank of faults the last reading of a channel; value: the sum of what it reads, NaN for no evidence."""
    a, parameters, mem = spot[0], spot[6], bench[spot[MEM] : spot[CONSTANTS]]
    places = kalman.memory_offsets(spot[:8])
    verdict, near = places[8], shaped(mem[places[7] : places[8]], a, 9 + parameters)
    used, time_s = mem[verdict + 2] != 0.0, mem[verdict + 3 + 2 * a + LAST_S]
    dof = int(mem[verdict + 1])
    limit = bench[spot[LIMITS] + dof] if dof > 0 and mem[verdict] < math.inf else 0.0
    if spot[NORTH] >= 0 and abs(mem[verdict + 3 + spot[NORTH]]) > LINEAR_RAD:
        limit = 0.0
    bank, motion = bench[spot[BANK] :], bench[spot[RATE] : spot[RATE] + 6]
    fault_bank.take_reading(bank, mem, spot, places, near, nav, motion, band, spot[INDEX], time_s, value, limit, used)


@njit(apart=True, cache=True, **UNCOUNTED)
def _note_row(now, cursor, interval_s, nav, xd, x, P, acc, inertial, own, rows, info, work):
    """Write the state down as a row: the last note of a time stands, those closer than the interval are skipped.

    xd: the first of x, those of the drive. rows (r, w): nav, x, then the lower triangle of P or its first nine rows
    and columns and the rest of its diagonal, as `kalman.present` gives them where samples have not been folded yet.
    info (r, 4): time, after how many records, and what stands in `now` from `UNNOTICED` on. inertial, own: see
    `consistency.attitude_second_order`.
    """
    at, n = cursor[ROWS], P.shape[0]
    if now[TIME_S] == now[ROW_S] and at > 0:
        at -= 1
    elif now[TIME_S] != now[ROW_S] and now[TIME_S] - now[ROW_S] < interval_s:
        return
    row = rows[at]
    for i in range(17):
        row[i] = nav[i]
    for i in range(xd.size):
        row[17 + i] = xd[i]
    for i in range(xd.size, n - 9):
        row[17 + i] = x[i]
    if row.size == n + 8 + n * (n + 1) // 2:
        first = n + 8
        for i in range(n):
            for j in range(i + 1):
                row[first + j] = P[i, j]
            first += i + 1
    elif cursor[UNFOLDED] > 0:
        kalman.present(P, acc, nav, inertial, own, work, row[n + 8 :])
    else:
        for i in range(9):
            for j in range(9):
                row[n + 8 + 9 * i + j] = P[i, j]
        for i in range(9, n):
            row[n + 80 + i] = P[i, i]
    info[at, 0], info[at, 1] = now[TIME_S], cursor[RECORDS]
    info[at, 2], info[at, 3] = now[UNNOTICED], now[UNNOTICED + 1]
    now[ROW_S] = now[TIME_S]
    cursor[ROWS] = at + 1


@njit(apart=True, cache=True, **UNCOUNTED)
def _note_record(record, axes, dims, cursor, records, heads):
    """Write a record for the smoother: nothing where `records` is empty. heads (r, 6): size, axes, head, size and
    start of the ticked block, place of a deviation; a head of 0 where the transition is the identity, which is
    left out.
    """
    if records.size == 0:
        return
    m = dims[2]
    if kalman.is_identity(shaped(record[: m * m], m, m)):
        record, m = record[m * m :], int(0)
    at, begin = cursor[RECORDS], cursor[WRITTEN]
    for i in range(record.size):
        records[begin + i] = record[i]
    head = heads[at]
    head[0], head[1], head[2], head[3], head[4], head[5] = record.size, axes, m, dims[3], dims[4], dims[7]
    cursor[RECORDS], cursor[WRITTEN] = at + 1, begin + record.size


@njit(cache=True, **UNCOUNTED)
def _has_room(cursor, size, rows, records, heads):
    """Whether there is room for one more row, and for a record of that size."""
    if cursor[ROWS] >= rows.shape[0] or cursor[RECORDS] >= heads.shape[0]:
        return False
    return records.size == 0 or cursor[WRITTEN] + size <= records.size


@njit(apart=True, cache=True, **UNCOUNTED)
def gravity_is_due(w, nav, P, period_s):
    """While all axes are good, `navfilter.faults.imu.monitor.ImuMonitor.heed`: the reference of gravity is due."""
    for i in range(6):
        a = w[i]
        good = a[imu_checks.CODE] == imu_checks.GOOD and a[imu_checks.HEEDED] == imu_checks.GOOD
        if not good or a[imu_checks.SIZE] != 0.0:
            return False
    unit = w[imu_checks.UNIT]
    if unit[imu_checks.TICK] * period_s >= imu_checks.JUDGED_S:
        unit[imu_checks.TICK] = 0.0
        g = strapdown.gravity(nav[0], nav[2])
        for i in range(3):
            unit[imu_checks.REFERENCE + i] = -g * nav[12 + i]
        unit[imu_checks.GRAVITY] = g
        unit[imu_checks.SURE] = 1.0 if P[6, 6] + P[7, 7] < imu_checks.LEVEL_SD**2 else 0.0
        if unit[imu_checks.SURE] != 0.0:
            for i in range(2):
                unit[imu_checks.TILTED + i] = max(unit[imu_checks.TILTED + i], abs(nav[13 - i]))
    return True


@njit(apart=True, cache=True, **UNCOUNTED)
def _keep_recent(block, recent, cursor):
    """Put the samples of a block before the last ones, the newest first."""
    for n in range(block.shape[0]):
        if cursor[NEWEST] == 0:
            for i in range(recent.shape[0] - MORE_RECENT - 1, -1, -1):
                for j in range(7):
                    recent[MORE_RECENT + i, j] = recent[i, j]
            cursor[NEWEST] = MORE_RECENT
        cursor[NEWEST] -= 1
        for j in range(7):
            recent[cursor[NEWEST], j] = block[n, j]


@njit(apart=True, cache=True, **UNCOUNTED)
def _propagated(now, cursor, settings, spot, P, nav, x, acc, drive, samples, stamps, undone, out, work, bank):
    """Carry the state over a block of steps (see `strapdown.stamps_to_steps`), folding as often as is due; says why
    it ended: all is `DONE`, the output is `FULL`, or Python has to `HEED` what the watch over the drive has found,
    or to feel whether the vehicle rests.

    stamps: of the same samples; spot: last row of `plan`; drive: memory, Phi, Q and output rows of the drive, its
    last samples (`MORE_RECENT` rows more than are needed), then what the watch remembers, and its standard
    deviations and limits; undone: see `record_residual`, empty where nobody listens; out: rows, their info, records and
    their heads; work: a transition (m * m,), then for `kalman.fold` and `kalman.present`.
    """
    m, n = acc.shape[1], P.shape[0]
    drv, Phid, Qd, Cr, recent, w, sd, ends = drive
    rows, info, records, heads, trace = out
    every, begin, total = int(settings[FOLD_EVERY]), 0, samples.shape[0]
    head, felt, each = work[: m * m], int(settings[FELT]), trace.shape[0] > 0
    xd, interval_s = x[: m - 9], settings[INTERVAL_S]
    inertial, own = drv[strapdown.INERTIAL] == strapdown.FELT, drv[strapdown.OWN]
    while begin < total:
        if not _has_room(cursor, m * m, rows, records, heads):
            return FULL
        end = min(total, begin + every - cursor[UNFOLDED])
        if each:
            end = min(end, begin + min(trace.shape[0], rows.shape[0] - cursor[ROWS]))
        if felt > 0:
            end = min(end, begin + max(1, felt - int(drv[strapdown.COUNT])))
        if w.shape[0] > 0:
            steps = settings[INCREMENTS] > 0.0
            end = begin + imu_checks.check_samples(samples[begin:end], w, sd, ends, settings[PERIOD_S], steps)
        else:
            end = begin + strapdown.until_odd(drv, samples[begin:end])
        block = samples[begin:end]
        addresses.at_steps(spot[STEPS], (nav, xd, drv, block, Phid, Qd, Cr, acc, trace[: end - begin]))
        if recent.shape[0] > 0:
            _keep_recent(block, recent, cursor)
        cursor[UNFOLDED] += end - begin
        cursor[SAMPLE] += end - begin
        for i in range(begin, end - 1 if each else begin):
            left, now[TIME_S] = trace[i - begin], stamps[i]
            Phi_and_Q = shaped(left[8 + m :], 2 * m, m)
            before = left[:17], left[17 : 8 + m], x, P, Phi_and_Q, inertial, own
            _note_row(*(now, cursor, interval_s, *before, rows, info), work[m * m :])
        now[TIME_S] = now[SAMPLE_S] = now[BEFORE_S] = stamps[end - 1]
        if cursor[UNFOLDED] >= every:
            if inertial:
                consistency.attitude_second_order(P, acc, nav, own, work[m * m :])
            transition = flat(acc)
            for i in range(m * m):
                head[i] = transition[i]
            kalman.fold(P, acc, nav, shaped(work[m * m : m * m + m * n], m, n))
            cursor[UNFOLDED] = 0
            if undone.size > 0:
                open_loop_residual.carry_feedback(undone, shaped(head, m, m))
            if spot[BANK]:
                fault_bank.carry(bank, shaped(head, m, m), int(0))
            _note_record(head, int(0), spot, cursor, records, heads)
        if cursor[UNFOLDED] == 0 or each:
            _note_row(now, cursor, interval_s, nav, xd, x, P, acc, inertial, own, rows, info, work[m * m :])
        begin = end
        if felt > 0 and drv[strapdown.COUNT] >= felt:
            return HEED
        news = w.shape[0] > 0 and w[imu_checks.UNIT, imu_checks.NEWS] != 0.0
        if (news and not gravity_is_due(w, nav, P, settings[PERIOD_S])) or strapdown.has_jumped(drv):
            return HEED
    return DONE


@njit(cache=True, inline="always", **UNCOUNTED)
def _four_matrices(hand, k):
    """Of rows k to k + 3 of `hand`, see `standing`."""
    a, b = standing(hand, k, np.float64), standing(hand, k + 1, np.float64)
    return a, b, standing(hand, k + 2, np.float64), standing(hand, k + 3, np.float64)


@njit(cache=True, inline="always", **UNCOUNTED)
def _four_vectors(hand, k):
    """The same, each as one row."""
    a, b, c, d = _four_matrices(hand, k)
    return flat(a), flat(b), flat(c), flat(d)


@njit(cache=True, **UNCOUNTED)
def propagate_sample(hand, samples, before_s, offset_s, at):
    """One sample live, by the same kernels as those of a replay in `run_batch`: `DONE`, or `HEED` where the watch
    over the drive has found something; `REFUSED`, and nothing has been done, where it does not follow the last one.

    hand (HELD_FOR_SAMPLES, 3): where arrays stand, as for `correct_reading`. spans: silence that is a gap, silence that
    is in doubt, period; limits: of its values; sd, ends: standard deviations and limits by which the watch looks;
    piece: the last one of the samples that are kept, and in which row of it this one is (-1: none are kept). samples
    (1, 7): stamp and values, as they came; before_s: stamp of the last one, moved by `offset_s`, as this one will be.
    """
    nav, x, drv, spans = _four_vectors(hand, 0)
    limits, sd, ends, _ = _four_vectors(hand, 4)
    w, P, acc, Phid = _four_matrices(hand, 7)
    Qd, Cr, piece, _ = _four_matrices(hand, 11)
    plan = standing(hand, 14, np.int64)
    stamp_s, gap_s, doubt_s, period_s = samples[0, 0], spans[0], spans[1], spans[2]
    samples[0, 0] += offset_s
    late = samples[0, 0] - before_s > gap_s
    if late or strapdown.stamps_to_steps(samples, before_s, limits, gap_s, doubt_s) != 0:
        samples[0, 0] = stamp_s
        return REFUSED
    if at >= 0:
        piece[at, 0] = stamp_s
        for j in range(1, 7):
            piece[at, j] = samples[0, j]
    steps = drv[strapdown.INCREMENTS] > 0.0
    if w.shape[0] > 0:
        imu_checks.check_samples(samples, w, sd, ends, period_s, steps)
    spot, xd = plan[plan.shape[0] - 1], x[: acc.shape[1] - 9]
    addresses.at_steps(spot[STEPS], (nav, xd, drv, samples, Phid, Qd, Cr, acc, acc[:0]))
    news = w.shape[0] > 0 and w[imu_checks.UNIT, imu_checks.NEWS] != 0.0
    heed = (news and not gravity_is_due(w, nav, P, period_s)) or strapdown.has_jumped(drv)
    return HEED if heed else DONE


@njit(cache=True, **UNCOUNTED)
def _uses_part(note, a):
    """Whether components of a reading that was used have been left out."""
    known = 0
    for i in range(a):
        known += not math.isnan(note[3 + i])
    return note[1] < known


@njit(cache=True, **UNCOUNTED)
def _note_arrival(watch, time_s, same):
    """Note that a reading arrives, as `navfilter.faults.sensor_monitor.SensorMonitor` does; same: with the
    value before.
    """
    if same:
        watch[SAME] += 1.0
    else:
        watch[SAME], watch[SINCE_S] = 1.0, time_s


@njit(cache=True, **UNCOUNTED)
def _note_used(watch, time_s, nis, dof, nav):
    """Note that a reading was used, as `navfilter.faults.sensor_monitor.SensorMonitor` does."""
    watch[USED] += 1.0
    watch[LATITUDE], watch[LONGITUDE] = nav[0], nav[1]
    watch[HEARD_S], watch[USED_S] = max(watch[HEARD_S], time_s), max(watch[USED_S], time_s)
    if dof >= watch[MOST]:
        watch[MOST], watch[WHOLE_S] = dof, max(watch[WHOLE_S], time_s)
    if dof > 0.0 and math.isfinite(nis):
        share = min(nis / dof, NIS_MOST)
        before = 1.0 if math.isnan(watch[NIS]) else watch[NIS]
        watch[NIS] = before + (share - before) / NIS_MEMORY


@njit(cache=True, **UNCOUNTED)
def _plain_reading(z, most, read):
    """Take a reading as it is, with NaN behind it; False for one that its sensor has to be asked about."""
    told = False
    for i in range(z.size):
        if not abs(z[i]) <= most:
            return False
        told |= z[i] != 0.0
        read[i] = z[i]
    for i in range(z.size, read.size):
        read[i] = math.nan
    return told


@njit(cache=True, **UNCOUNTED)
def _last_s(bench, own):
    """When a channel was read last [s]; own: its row of `plan`."""
    return bench[own[MEM] + own[VERDICT] + 3 + 2 * own[0] + LAST_S]


@njit(cache=True, **UNCOUNTED)
def _is_in_order(bench, plan, i, time_s, dive_s):
    """Whether a reading comes after the last of its channel, in its place among those of its time, and before the
    vehicle has dived.
    """
    for j in range(i, plan.shape[0] - 1):
        last_s = _last_s(bench, plan[j])
        if last_s == time_s or (j == i and last_s > time_s):
            return False
    used_s = bench[plan[i, MEM] + plan[i, VERDICT] + 3 + 2 * plan[i, 0] + TAKEN_S]
    return not dive_s < time_s - used_s < math.inf


@njit(cache=True, **UNCOUNTED)
def _correct_reading(bench, plan, own, state, drive, recent, reading, times):
    """Take a reading: hold the drive until its time, then `correction`. Returns the ticks of its clock, and whether
    it is used as a whole.

    own: row of `plan`; state: nav, x, P, acc; drive: memory, Phi, Q and output rows of the drive; reading: as its
    kernel takes it, and own variances; times: when it is taken, time of the state, how much later than its stamp a
    reading may be taken, period of its clock [s]; and whether the drive is held.
    """
    (nav, x, P, acc), (drv, Phid, Qd, Cr), (z, variance) = state, drive, reading
    time_s, now_s, wait_s, period_s, holds = times
    spot = plan[plan.shape[0] - 1]
    if holds:
        early_s = time_s - now_s
        addresses.at_hold(spot[HOLD], (nav, x[: acc.shape[1] - 9], drv, early_s, Phid, Qd, Cr, acc))
        now_s = time_s
    a, verdict = own[0], own[MEM] + own[VERDICT]
    noted = bench[verdict + 3 + 2 * a : verdict + 3 + 2 * a + NOTED]
    elapsed = time_s - noted[TICKED_S]
    count = 0 if math.isinf(elapsed) else int(max(1, round(elapsed / period_s)))
    noted[LAST_S], noted[TICKED_S] = time_s, time_s
    filter, given = (bench, own, P, nav, x, acc, drv, Cr, recent), (z, variance, count, wait_s + now_s - time_s)
    addresses.at_correction(spot[CORRECTION], filter + given)
    note = bench[verdict : verdict + 3 + a]
    return count, note[2] != 0.0 and not (own[PARTLY] and _uses_part(note, a))


@njit(cache=True, **UNCOUNTED)
def correct_reading(hand, recent, z, read, plain, time_s, now_s, kept_samples, kept_readings, kept_values):
    """One reading live, by the same kernels as those of a replay in `run_batch`, and all that is noted of it:
    `REFUSED`, and nothing has been done, where its sensor has to be asked, it is not the next one, or a piece of
    what is kept is full; `JUDGED` where it was not used, and Python says what follows; else `DONE`, or `LEARN`.
    Behind that its NIS and components, and the mean NIS of the ear.

    hand (HAND, 3): where arrays stand, their rows and columns, in the order in which they are taken here. facts:
    see `CHANNEL`; undone (empty where nobody listens), ear, ring, cursor: see `record_residual`; places:
    `kalman.memory_offsets`; figures: a row of `watched`; heads, values: the last pieces of the inputs that are kept,
    see `navfilter.filter.input_buffer`, and how many samples, readings (-1: none are kept here) and values these are.
    z: what arrived; read: what is read from it, work space for a `plain` one; early_s: by how much the state is older.
    The others are those of `correction`.
    """
    bench, nav, x, drv = _four_vectors(hand, 0)
    facts, undone, ear, figures = _four_vectors(hand, 4)
    P, acc, Phid, Qd = _four_matrices(hand, 8)
    Cr, ring, heads, values = _four_matrices(hand, 12)
    plan = standing(hand, 16, np.int64)
    places = flat(standing(hand, 17, np.int64))
    cursor = flat(standing(hand, 18, np.int64))
    i = int(facts[CHANNEL])
    own = plan[i]
    if (plain and not _plain_reading(z, facts[LARGEST], read)) or not _is_in_order(
        bench, plan, i, time_s, facts[DIVE_S]
    ):
        return REFUSED, 0.0, 0
    a, errors, verdict = own[0], own[5], own[MEM] + own[VERDICT]
    noted = bench[verdict + 3 + 2 * a : verdict + 3 + 2 * a + NOTED]
    if kept_readings >= 0:
        at, first = kept_readings % heads.shape[0], kept_values % heads.shape[0]
        if at == 0 or first == 0 or first + z.size > heads.shape[0]:
            return REFUSED, 0.0, 0
        row = heads[at]
        for j in range(z.size):
            values[first + j, 0] = z[j]
        row[0], row[1], row[2], row[3] = time_s, facts[KEPT_AS], 0.0, 0.0
        row[4], row[5] = float(kept_samples), float(kept_values + z.size)
    figures[SAME], figures[SINCE_S] = 1.0, time_s
    holds = time_s - now_s > SAME_S and drv[strapdown.STARTED] != 0.0
    state, drive, times = (nav, x, P, acc), (drv, Phid, Qd, Cr), (time_s, now_s, 0.0, facts[TICK_S], holds)
    count, used = _correct_reading(bench, plan, own, state, drive, recent, (read, read[:0]), times)
    note = bench[verdict : verdict + 3 + a]
    if not used:
        facts[TICKED] = count
        return JUDGED, note[0], int(note[1])
    noted[TAKEN_S] = time_s
    _note_used(figures, time_s, note[0], note[1], nav)
    if undone.size > 0:
        mem, mount = bench[own[MEM] : own[CONSTANTS]], ear[open_loop_residual.MOUNT :]
        C, kind = (shaped(bench[own[OUTPUT] : own[OUTPUT] + a * errors], a, errors), int(ear[open_loop_residual.KIND]))
        open_loop_residual.record_residual(
            undone, mem, own[:7], places, nav, C, x, kind, mount, ring, cursor, count, Cr, facts[TILTED]
        )
        learning = time_s >= facts[LEARNT_S]
        if kind != open_loop_residual.NOTHING and open_loop_residual.after_reading(
            ear, note[0], note[1], count, learning
        ):
            return LEARN, note[0], int(note[1])
    return DONE, note[0], int(note[1])


@njit(apart=True, cache=True, **UNCOUNTED)
def _record_residual(cursor, settings, bench, own, nav, x, Cr, t, ticks, undone, ear, places, opened):
    """What `navfilter.learning.schedule.LearningSchedule` does after a reading that was used; True when something
    is to be learnt. own: row of `plan`; ear, places, opened: see `run_batch`.
    """
    a, errors = own[0], own[5]
    rows = max(a + 1, int(ear[open_loop_residual.MOUNT + open_loop_residual.ROWS]))
    mem = bench[own[MEM] : own[CONSTANTS]]
    C = shaped(bench[own[OUTPUT] : own[OUTPUT] + a * errors], a, errors)
    cursor[SPARE], once = 0, int(1)
    open_loop_residual.record_residual(
        undone,
        mem,
        own[:7],
        places,
        nav,
        C,
        x,
        int(ear[open_loop_residual.KIND]),
        ear[open_loop_residual.MOUNT :],
        shaped(opened[1 : 1 + rows], rows, 1),
        cursor[SPARE : SPARE + 1],
        once,
        Cr,
        settings[GRAVITY],
    )
    opened[0] = ticks
    verdict = own[MEM] + own[VERDICT]
    return ear[open_loop_residual.KIND] != 0.0 and open_loop_residual.after_reading(
        ear, bench[verdict], bench[verdict + 1], ticks, t >= settings[LEARN_S]
    )


@njit(apart=True, cache=True, **UNCOUNTED)
def _described_nis(bench, own, P, nav, Cr, t, kept, facts, w):
    """NIS by its description of a reading that was used, of a sensor that scatters by more, see
    `noise_scale.update_scale`.

    own: row of `plan`; w: what the watch over the drive remembers: nothing is learnt while an axis is left out.
    """
    a, busy = own[0], w.shape[0] > 0 and w[w.shape[0] - 1, imu_checks.OFF_S] > 0.0
    for j in range(w.shape[0] - 1):
        busy |= w[j, imu_checks.HEEDED] > imu_checks.NOISY
    mine, mem = kept[: noise_scale.LAST + 3 * a + 2 * a * noise_scale.MOST], bench[own[MEM] : own[CONSTANTS]]
    R, S = shaped(bench[own[NOISE] : own[NOISE] + a * a], a, a), own[RECORD]
    return noise_scale.update_scale(mine, facts, mem, S, own[VERDICT], R, own[NORTH], P, nav, Cr, t, busy)


@njit(cache=True, **UNCOUNTED)
def _latest_s(bench, plan):
    """When any channel was read last [s]."""
    latest_s = -math.inf
    for i in range(plan.shape[0] - 1):
        latest_s = max(latest_s, _last_s(bench, plan[i]))
    return latest_s


@njit(cache=True, nogil=True, **UNCOUNTED)
def run_batch(
    now,
    cursor,
    settings,
    bench,
    plan,
    heard,
    watched,
    scattered,
    state,
    drive,
    samples,
    stamps,
    limits,
    hearing,
    given,
    out,
):
    """Samples and readings in the order of their times, until all are done or something is Python's; says why it
    ended.

    now, cursor, settings, plan, heard, watched, bench: as described at the head of this file; they, `scattered`
    (what is remembered and known of each channel, see `scatter`; no rows where none is watched) and `state` (nav,
    x, P, acc) are left as they are then. samples (s, 7): work space, their stamps first; stamps (s,);
    limits: of their values. hearing: `undone` (see `record_residual`; empty where nobody listens), ears of the
    channels, their `kalman.memory_offsets`, and (r, 1 + rows) for ticks and what `record_residual` notes of each
    reading. given, of readings: when taken (r,), channel, samples before
    it, whether Python has found nothing wrong with it, whether its value is that of the one before; values (r, w), and
    own variances (r, a), or one row of NaN; notes (r, 3 + 2a), which receive the verdicts. out: as in `_propagated`.
    """
    nav, x, P, acc = state
    drv, Phid, Qd, Cr, samples_before = drive[0], drive[1], drive[2], drive[3], drive[4]
    known, inertial = max(0, samples_before.shape[0] - MORE_RECENT), drv[strapdown.INERTIAL] == strapdown.FELT
    times, which, ends, good, same, values, variances, notes = given
    rows, info, records, heads, _ = out
    undone, ears, places, opened = hearing
    kept, facts = scattered
    m = acc.shape[1]
    period_s, spot = settings[PERIOD_S], plan[plan.shape[0] - 1]
    work, bank = bench[spot[MEM] :], bench[spot[BANK] :]
    for i in range(plan.shape[0]):
        plan[i, UNHEARD] = records.size == 0 and undone.size == 0 and spot[BANK] == 0
    for e in range(cursor[READING], times.size):
        cursor[READING] = e
        i, t, begin, end = which[e], times[e], cursor[SAMPLE], ends[e]
        if t >= settings[UNTIL_S] or not good[e] or not t < heard[i, USUAL_S]:
            return NEXT
        seen = watched[i]
        stuck = seen[SAME] + 1.0 >= STUCK_READINGS and seen[HEARD_S] - seen[SINCE_S] >= STUCK_S
        scatters = kept.shape[0] > 0 and kept[i, noise_scale.WATCHED] != 0.0
        if (undone.size > 0 or scatters) and same[e] and stuck:
            return NEXT
        if scatters and noise_scale.is_worthless(kept[i], plan[i, 0]):
            return NEXT
        if end > begin:
            block, taken = samples[begin:end], stamps[begin:end]
            if begin >= cursor[STEPPED]:
                gaps = strapdown.stamps_to_steps(block, now[BEFORE_S], limits, settings[GAP_S], settings[DOUBT_S])
                if gaps < 0:
                    return NEXT
                cursor[GAPS] += gaps
                cursor[STEPPED] = end
            why = _propagated(now, cursor, settings, spot, P, nav, x, acc, drive, block, taken, undone, out, work, bank)
            if why != DONE:
                return why
        if not _has_room(cursor, spot[RECORD], rows, records, heads):
            return FULL
        early_s, mine = t - now[TIME_S], heard[i]
        ahead_s = t - mine[WAIT_S] - now[SAMPLE_S]
        if t <= _last_s(bench, plan[i]) or early_s < -1.001 * period_s or ahead_s > settings[AHEAD_S]:
            return REFUSED
        _note_arrival(watched[i], t, same[e])
        holds = early_s <= 1.001 * period_s or mine[WAIT_S] == 0.0
        holds = holds and early_s > SAME_S and drv[strapdown.STARTED] != 0.0
        own, variance = plan[i], variances[min(e, variances.shape[0] - 1)]
        verdict, a = own[MEM] + own[VERDICT], own[0]
        if scatters:
            noise_scale.widen_variance(kept[i], facts[i], variance, a)
            variance = facts[i, noise_scale.BY_AXIS + 2 * a : noise_scale.BY_AXIS + 3 * a]
        recent = samples_before[cursor[NEWEST] : cursor[NEWEST] + known]
        times_of = t, now[TIME_S], mine[WAIT_S], mine[CHANNEL_PERIOD_S], holds
        drive_of = drv, Phid, Qd, Cr
        count, used = _correct_reading(bench, plan, own, state, drive_of, recent, (values[e], variance), times_of)
        if holds:
            now[TIME_S] = t
        cursor[UNFOLDED] = 0
        mine[TICKS] = count
        for j in range(3 + 2 * a):
            notes[e, j] = bench[verdict + j]
        if not used:
            return JUDGED
        if scatters:
            notes[e, 0] = bench[verdict] = _described_nis(bench, own, P, nav, Cr, t, kept[i], facts[i], drive[5])
        _note_record(bench[own[MEM] : own[MEM] + own[RECORD]], a, own, cursor, records, heads)
        by = drv[strapdown.OWN]
        _note_row(now, cursor, settings[INTERVAL_S], nav, x[: m - 9], x, P, acc, inertial, by, rows, info, work)
        _note_used(watched[i], t, notes[e, 0], notes[e, 1], nav)
        if undone.size > 0 and _record_residual(
            cursor, settings, bench, own, nav, x, Cr, t, count, undone, ears[i], places[i], opened[e]
        ):
            cursor[READING] = e + 1
            return LEARN
        if t >= settings[LOOK_S]:
            latest_s = _latest_s(bench, plan)
            settings[LOOK_S] = (math.floor(latest_s / LOOK_EVERY_S) + 1.0) * LOOK_EVERY_S
            suspected = fault_bank.look(bank, latest_s) > fault_bank.BELIEVED
            now[UNNOTICED], now[UNNOTICED + 1] = bank[fault_bank.RADIUS_M], bank[fault_bank.HEADING_RAD]
            _note_row(now, cursor, settings[INTERVAL_S], nav, x[: m - 9], x, P, acc, inertial, by, rows, info, work)
            if suspected:
                cursor[READING] = e + 1
                return LOOK
    cursor[READING] = times.size
    return DONE
