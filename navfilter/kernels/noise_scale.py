"""Kernel of a sensor that scatters by more than its error model says, see `navfilter.faults.noise_scale`."""

import math

from navfilter.kernels.compiling.decorators import UNCOUNTED, njit, shaped

# It is looked at once so many readings were refused within the last ones, the older the less [1]: of good ones three in
# a thousand are.
REFUSED_READINGS, READINGS = 3.0, 16.0
# By so many differences at most, and at the earliest [1].
MOST, LEAST = 48, 8
# It ends when this many do not show it any more [1].
ENDS = 16
# The largest quarter of them says nothing: a reading that is far off is in two of them. Of the squares of normal
# variables the others have this mean [1].
KEPT, MEAN_OF_KEPT = 0.75, 0.3685
# A variance that is larger by less than this factor is no noise that was not described [1]: so far off is one estimate
# by `LEAST` differences in a hundred.
LARGER = 2.5
# One that is larger by more is no noise [1]: a thousand times the sd is another unit, a hundred times bad reception.
NO_NOISE = 300.0**2
# Readings further apart than so many periods tell no noise [1].
APART = 3.0
# The square of a second difference of white noise is so many times its variance [1]; of a random walk, twice that of a
# step.
WHITE, STEP = 6.0, 2.0
# A variance that is less, as a share of what it was before others were taken off, is rounding [1].
ROUNDED = 1e-12
# No variance that is divided by is less, in the square of any unit [1].
LEAST_VARIANCE = 1e-300
GRAVITY = 9.81  # of a tilt, as an acceleration [m/s^2]; to a percent

# What is remembered: readings that were refused, older ones counting less; time of the last [s]; whether every reading
# has to be heard; how many up to the last were refused on end; how many second differences there are, and where the
# next one goes. Behind that, for each axis, the last residual, by how much it differed from the one before, and what is
# added to the variance of the next (infinite: it says nothing); then `MOST` rows of second differences of the readings
# by axis, with what else than noise is in each, as variances of one reading.
REFUSED, TIME_S, WATCHED, ALONE, COUNT, NEXT, LAST = range(7)
# Facts of a sensor: whether what leads its readings astray goes as the time (a velocity, and a height, beside
# accelerometers); whether it is a heading, a velocity, or another; its period, and that of the drive [s]. Behind that,
# for each axis, by how much its coloured error may change in a period, as a variance, its white variance, room for that
# of a reading, and work space.
LASTING, KIND, PERIOD_S, DRIVE_PERIOD_S, BY_AXIS = range(5)
HEADING, VELOCITY, OTHER = range(3)


@njit(cache=True, **UNCOUNTED)
def _walked(dt, Cr, period_s):
    """Variance by which the noise of accelerometers errs in a time [m^2/s^2]; Cr: see `delayed_state.drive_outputs`."""
    last = Cr.shape[1] - 1
    return max(Cr[3, last], Cr[4, last], Cr[5, last]) * period_s * dt


@njit(cache=True, **UNCOUNTED)
def _reckoned(kind, P, speed, dt, Cr, period_s):
    """Variance by which dead reckoning may err in a time, in the units of a sensor; see
    `navfilter.faults.sensor_bias`.
    """
    e = Cr.shape[1] - 1
    if kind == OTHER:
        return (max(P[3, 3], P[4, 4], P[5, 5]) + speed * speed * P[8, 8]) * dt * dt
    first, most = 0 if kind == HEADING else 3, -math.inf
    for i in range(first, first + 3):
        lasting = 0.0
        for j in range(e):
            if Cr[i, j] != 0.0:
                for k in range(e):
                    lasting += Cr[i, j] * P[9 + j, 9 + k] * Cr[i, k]
        most = max(most, lasting)
    if kind == HEADING:
        return most * dt * dt + max(Cr[0, e], Cr[1, e], Cr[2, e]) * period_s * dt
    return (most + GRAVITY * GRAVITY * max(P[6, 6], P[7, 7])) * dt * dt + _walked(dt, Cr, period_s)


@njit(cache=True, **UNCOUNTED)
def _put(values, count, value):
    """Put a value among others that are in order."""
    k = count
    while k > 0 and values[k - 1] > value:
        values[k] = values[k - 1]
        k -= 1
    values[k] = value


@njit(cache=True, **UNCOUNTED)
def _median_square(values, count):
    """Mean of squares of normal variables, in order; 0 where they are too few."""
    if count < LEAST:
        return 0.0
    kept, total = int(KEPT * count), 0.0
    for k in range(kept):
        total += values[k]
    return total / kept / MEAN_OF_KEPT


@njit(apart=True, cache=True, **UNCOUNTED)
def excess_variance(bends, axis, latest, newest, white, work):
    """What a sensor scatters by beyond its variance in one axis: 0 where it does not, or where nobody can tell.

    bends (`MOST`, 2a): second differences of its readings, NaN where a component was missing, then what else than its
    noise is in each, as a variance of one reading; newest: row of the latest one, before which the earlier ones stand,
    round and round; latest: how many count; white: its variance; work (3 * `MOST`,).
    """
    a, count = bends.shape[1] // 2, 0
    ratios, slack, squares = work[:MOST], work[MOST : 2 * MOST], work[2 * MOST : 3 * MOST]
    for k in range(latest):
        row = bends[(newest - k) % MOST]
        if math.isfinite(row[axis]):
            _put(ratios, count, row[axis] ** 2 / WHITE / max(white + row[a + axis], LEAST_VARIANCE))
            _put(slack, count, row[a + axis])
            count += 1
    ratio = _median_square(ratios, count)
    if ratio > NO_NOISE:
        return math.inf
    if not ratio > LARGER:
        return 0.0
    middle, telling = 0.5 * (slack[(count - 1) // 2] + slack[count // 2]), 0  # half of all tell
    for k in range(latest):
        row = bends[(newest - k) % MOST]
        if math.isfinite(row[axis]) and row[a + axis] <= middle:
            _put(squares, telling, row[axis] ** 2 / WHITE - row[a + axis])
            telling += 1
    return min(max(_median_square(squares, telling) - white, (LARGER - 1.0) * white), NO_NOISE * white)


@njit(cache=True, **UNCOUNTED)
def _by_description(mem, S, note, excess, work):
    """NIS of a reading without the variances that were added to its own, by the Cholesky factor of what is left."""
    a, nis = excess.size, 0.0
    L, y = shaped(work[: a * a], a, a), work[a * a : a * a + a]
    for i in range(a):
        if not math.isfinite(note[3 + a + i]):
            y[i] = math.nan  # a component that was missing
            continue
        rest = note[3 + i]
        for j in range(i + 1):
            if j < i and math.isnan(y[j]):  # its own stands there from before
                continue
            left = mem[S + i * a + j] - (excess[i] if i == j else 0.0)
            for k in range(j):
                if not math.isnan(y[k]):
                    left -= L[i, k] * L[j, k]
            if j < i:
                L[i, j] = left / L[j, j]
                rest -= L[i, j] * y[j]
            elif left > ROUNDED * mem[S + i * a + i]:
                L[i, i] = math.sqrt(left)
            else:
                rest, L[i, i] = math.nan, 1.0  # what the others of the reading tell to the last digit says nothing
        y[i] = rest / L[i, i]
        nis += y[i] * y[i] if not math.isnan(y[i]) else 0.0
    return nis


@njit(cache=True, **UNCOUNTED)
def widen_variance(kept, facts, variance, axes):
    """Put the white variances of a reading, with what its sensor scatters by beyond them, into their room in `facts`;
    `variance`: its own, NaN for those of the error model.
    """
    for i in range(axes):
        own = facts[BY_AXIS + axes + i] if math.isnan(variance[0]) else variance[i]
        facts[BY_AXIS + 2 * axes + i] = own + kept[LAST + 2 * axes + i]


@njit(cache=True, **UNCOUNTED)
def is_worthless(kept, axes):
    """Whether an axis scatters by so much that its readings say nothing: its excess is infinite."""
    endless = False
    for i in range(axes):
        endless |= math.isinf(kept[LAST + 2 * axes + i])
    return endless


@njit(apart=True, cache=True, **UNCOUNTED)
def update_scale(kept, facts, mem, S, verdict, R, north, P, nav, Cr, time_s, ignored):
    """Take a reading, as its correction left it, and return its NIS by the description of its sensor.

    kept, facts: as described at the head of this file; mem: working memory of its channel, in which its S and what its
    verdict is stand from there on; R (a, a): its white covariance; north: which of its axes is the heading (-1: none);
    P, nav: state; Cr: output rows of the drive; ignored: it says nothing of the noise.
    """
    a, nis, used = R.shape[0], mem[verdict], mem[verdict + 2] != 0.0
    note, dt, period_s = mem[verdict : verdict + 3 + 2 * a], time_s - kept[TIME_S], facts[PERIOD_S]
    last, step_before = kept[LAST : LAST + a], kept[LAST + a : LAST + 2 * a]
    excess, bends = kept[LAST + 2 * a : LAST + 3 * a], shaped(kept[LAST + 3 * a :], MOST, 2 * a)
    refused, watched = kept[REFUSED], kept[WATCHED] != 0.0
    refused = refused * math.exp(-max(dt, 0.0) / (READINGS * period_s)) if refused > 0.0 else 0.0
    refused += 0.0 if used else 1.0
    if ignored or not (watched or refused >= REFUSED_READINGS):
        for k in range(kept.size):
            kept[k] = 0.0
        kept[REFUSED], kept[TIME_S] = refused, time_s
        return nis
    added, worthless = False, False
    for i in range(a):
        added |= excess[i] != 0.0
        worthless |= math.isinf(excess[i])
    added &= not worthless
    if watched and dt <= APART * period_s:
        row, lasting = bends[int(kept[NEXT])], facts[LASTING] != 0.0
        alone = added or kept[ALONE] > 1.0
        pushed = _walked(period_s, Cr, facts[DRIVE_PERIOD_S]) if lasting else 0.0
        pushed *= STEP if facts[KIND] == VELOCITY else period_s * period_s
        for i in range(a):
            step = note[3 + i] - last[i]
            if i == north:
                step = (step + math.pi) % (2.0 * math.pi) - math.pi
            row[i], row[a + i] = step - step_before[i], 0.0
            if lasting:
                seen = 0.0 if alone else max(mem[S + i * a + i] - R[i, i], 0.0)
                row[a + i] = (facts[BY_AXIS + i] * STEP + pushed) / WHITE + seen
            step_before[i] = step
        kept[NEXT] = (int(kept[NEXT]) + 1) % MOST
        kept[COUNT] = min(int(kept[COUNT]) + 1, MOST)
    else:
        for i in range(a):
            step_before[i] = math.nan
    nis = _by_description(mem, S, note, excess, facts[BY_AXIS + 3 * a :]) if added else nis
    slack = 0.0
    if facts[LASTING] == 0.0:
        speed = math.sqrt(nav[3] ** 2 + nav[4] ** 2 + nav[5] ** 2)
        slack = _reckoned(facts[KIND], P, speed, period_s, Cr, facts[DRIVE_PERIOD_S])
    count, newest, found = int(kept[COUNT]), (int(kept[NEXT]) - 1) % MOST, False
    work, plain = facts[BY_AXIS + 3 * a :], facts[BY_AXIS + 2 * a : BY_AXIS + 3 * a]
    for i in range(a):
        plain[i] = R[i, i] - (excess[i] if added else 0.0)
        if facts[LASTING] == 0.0:
            plain[i] += (facts[BY_AXIS + i] + slack) * STEP / WHITE
        found |= excess_variance(bends, i, min(count, ENDS), newest, plain[i], work) != 0.0
    for i in range(a):
        excess[i] = excess_variance(bends, i, count, newest, plain[i], work) if found else 0.0
    found = False
    for i in range(a):
        found |= excess[i] != 0.0
    if count == MOST and not found and refused < 1.0:
        for k in range(kept.size):
            kept[k] = 0.0
        kept[TIME_S] = -math.inf
        return nis
    kept[REFUSED], kept[TIME_S], kept[WATCHED] = refused, time_s, 1.0
    kept[ALONE] = 0.0 if used else kept[ALONE] + 1.0
    for i in range(a):
        last[i] = note[3 + i]
    return nis
