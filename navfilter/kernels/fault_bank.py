"""The recursion of a bank of faults: what each would have done to the filter, and what the innovations say of it.

Generalised likelihood ratios of Willsky and Jones (1976). A hypothesis is a signature and an onset: from then on a
fault of unit size acts on a reading (F) or on a state of the drive. The nominal filter knows nothing of it, and carries
an error D of its state along; its innovations then have the mean G = H D + F::

    D <- Phi D,    J += G' S^-1 G,    s += G' S^-1 y,    D <- D - K G

J is the information that the innovations y have of the size, and s the score. With a prior N(0, V) of the size its
posterior is N(M s, M), M = (J + V^-1)^-1, and what it adds to the log likelihood is s' M s / 2 - log |I + V J| / 2.

``bank``: the head below, the onsets of the windows, a row of `TABLE` for each signature, D (states, columns), s
(columns,), J (columns, columns), of which nothing above the diagonal counts, what is on top of the log odds (columns,),
and a row of `HEARD` for each channel; behind that work space. Of a fault there is a column for each window in turn;
behind these, in the last window, which begins with the mission and is never moved on, one for each signature of a wrong
start or description.

Innovations whose sums from look to look are larger than white ones' are of an error model that is wrong: they count as
much less, for a fault is no more than what they would not be without it.
"""

import math

import numpy as np

from navfilter.kernels import consistency, strapdown, symmetric
from navfilter.kernels.compiling.decorators import UNCOUNTED, flat, njit, scratch, shaped
from navfilter.kernels.compiling.vectors import add_product, less_half, weighted

# Head: signatures of faults, states, channels, looks so far, time of the last look; log odds of the likeliest fault
# then, and how far faults that nobody has noticed may have moved the position and turned the heading; time of the last
# reading; signatures of a wrong start or description, which stand behind the others; and sd of the white noise of an
# angular rate.
SIGNATURES, STATES, CHANNELS, LOOKS, LOOKED_S, ODDS, RADIUS_M, HEADING_RAD, READ_S, BEGUN, RATE_SD, ONSETS = range(12)
# A signature: how it acts; the channel that it is of (-1: none); an axis of that, north or east, or a state; the
# variance of its size (of a ramp: of what it has come to), the log of how often it happens in a second (of a wrong
# start or description: in a mission), how many signatures are of one fault with it (0: it belongs to the one before),
# and how many axes read what moves.
KIND, CHANNEL, PLACE, VARIANCE, RATE, TOGETHER, READ, TABLE = range(8)
# How it acts: a constant or a ramp of one axis of a reading; the same of the velocity of what a velocity is read
# against; a step or a drift of a state; a component of how a velocity sensor is described (`description_slope`); a
# scale of a velocity.
STEP, RAMP, FLOW_STEP, FLOW_RAMP, STATE, DRIFT, DESCRIBED, SCALE = range(8)
# A fault is believed that is so much likelier than none [nat]: an error of one in twenty thousand; and believed to be
# none where that is so much likelier than the fault: one in twenty. (chosen)
BELIEVED, GONE = 10.0, 3.0
# What is described rightly, and is no state, is so to this share of what it may be off by otherwise: 1 cm, 5 ms, 0.05
# deg. (chosen)
RIGHT = 0.005
# Windows: the onset of each is moved on half as often as that of the one before, the first at every other look, the
# last after eleven minutes. (chosen) The window behind them is the whole mission.
WINDOWS = 6
# Of each channel: mean square of the sums of its innovations from look to look, in their sd, and mean product of one
# with the next; from how many looks these are told; readings since the last look, the sums of their axes, and those
# before, of so many at most; and how much larger than white ones they were before the onset of each window (0: hardly
# anything was told); angular rate and specific force at its last reading, and the velocity in b by which slopes go; how
# much larger H P H' is than R, summed over the readings refused on end, and the sum of the values of the last reading.
SQUARE, PRODUCT, TOLD, READINGS, SUMS = range(5)
AXES = 8  # of more the first are summed
BEFORE = SUMS + 2 * AXES
THEN = BEFORE + WINDOWS + 1
REFUSED, VALUE = THEN + 9, THEN + 10
HEARD = VALUE + 1
# Before anything is told an error may be twice as large as described, as by so many looks; it is told by so many looks
# at most, each of which says no more than so many sds; none is correlated with the next by more than that. (chosen)
DOUBLED, DOUBTED, MEMORY, MOST, CORRELATED = 4.0, 5.0, 60.0, 10.0, 0.98
# Until so many looks what innovations tell is of the start: a minute, as sensors confirm it. After as many an error
# model is told. (chosen)
CONFIRMED = 6
# Share of the time that the truth may lie beyond a bound [1], see `navfilter.faults.settings`.
RISK = 1e-3


@njit(cache=True, **UNCOUNTED)
def width(bank):
    """How many columns there are."""
    return WINDOWS * int(bank[SIGNATURES]) + int(bank[BEGUN])


@njit(cache=True, **UNCOUNTED)
def signatures_of(bank, window):
    """The first signature of a window, the one behind its last, and the column of the first."""
    c = int(bank[SIGNATURES])
    return (c, c + int(bank[BEGUN]), WINDOWS * c) if window == WINDOWS else (0, c, window * c)


@njit(cache=True, **UNCOUNTED)
def places(bank):
    """Where table, D, s, J, what is on top of the odds, what is known of channels and the work space begin."""
    c, n, columns = int(bank[SIGNATURES]), int(bank[STATES]), width(bank)
    table = ONSETS + WINDOWS + 1
    D = table + (c + int(bank[BEGUN])) * TABLE
    s = D + n * columns
    J = s + columns
    more = J + columns**2
    heard = more + columns
    return table, D, s, J, more, heard, heard + int(bank[CHANNELS]) * HEARD


@njit(apart=True, cache=True, **UNCOUNTED)
def carry(bank, Phi, first):
    """D <- Phi D for the states from `first` on; Phi (k, k)."""
    columns, m = width(bank), Phi.shape[0]
    _, begin, end, _, _, _, room = places(bank)
    D, work = shaped(bank[begin:end], int(bank[STATES]), columns), shaped(bank[room : room + m * columns], m, columns)
    for i in range(m):
        if _moves(Phi, i):
            weighted(Phi[i], D[first : first + m], work[i])
    for i in range(m):
        if _moves(Phi, i):
            symmetric.copy(work[i], D[first + i])


@njit(cache=True, **UNCOUNTED)
def _moves(Phi, i):
    """Whether a state becomes anything but itself."""
    others = 0
    for r in range(Phi.shape[0]):
        others += r != i and Phi[i, r] != 0.0
    return others > 0 or Phi[i, i] != 1.0


@njit(cache=True, **UNCOUNTED)
def larger(own):
    """How much larger the variance of a long sum of innovations is than that of white ones of their sd."""
    correlation = max(0.0, min(own[PRODUCT] / own[SQUARE], CORRELATED))
    return max(own[SQUARE], 1.0) * (1.0 + correlation) / (1.0 - correlation)


@njit(cache=True, **UNCOUNTED)
def description_slope(component, nav, velocity, motion, output):
    """What a component of how a velocity sensor is described adds to the velocity over ground, per unit.

    component: see `navfilter.models.fault_bias.FaultDescription`; velocity (3,): over ground in n; motion (6,): angular
    rate and specific force in b; output (3,).
    """
    by = scratch(np.float64, int(2), 3)  # rate and acceleration in n
    for k in range(3):
        by[0, k], by[1, k] = 0.0, 0.0
        for i in range(3):
            by[0, k] += nav[6 + 3 * k + i] * motion[i]
            by[1, k] += nav[6 + 3 * k + i] * motion[3 + i]
    by[1, 2] += strapdown.gravity(nav[0], nav[2])
    felt = 1.0 if motion[3] != 0.0 or motion[4] != 0.0 or motion[5] != 0.0 else 0.0
    for k in range(3):
        one, two = (k + 1) % 3, (k + 2) % 3
        if component < 3:
            output[k] = by[0, one] * nav[6 + 3 * two + component] - by[0, two] * nav[6 + 3 * one + component]
        elif component > 3:  # an instrument that is turned about an axis of b
            axis = component - 4
            output[k] = velocity[one] * nav[6 + 3 * two + axis] - velocity[two] * nav[6 + 3 * one + axis]
        else:  # a stamp that is late shows the velocity in b before; where no force is felt nobody knows that
            output[k] = (by[0, one] * velocity[two] - by[0, two] * velocity[one] - by[1, k]) * felt


@njit(apart=True, cache=True, **UNCOUNTED)
def take_reading(bank, mem, dims, at, near, nav, motion, band, channel, time_s, value, limit, used):
    """A reading as the filter left it in its channel's memory.

    dims, at: see `kalman.memory_offsets`; near (a, 9 + parameters): its Jacobian; nav: the state as foretold; motion
    (6,): angular rate and specific force in b; band: see `consistency.velocity_band`; channel: its place among all;
    value: the sum of what it reads, NaN where that is no evidence; limit: of its gate, 0 where that is shut; used:
    whether it corrected the state.

    Slopes go by rate and force of the reading before, and rate and velocity are held within what is known of them.
    Those of now err as the innovation does, which would then show every scale, arm and clock a little (errors in
    variables: Fuller, 1987, sec. 1.1); and what noise a rate had then is in the state, by the lever arm. One that its
    gate has refused is off by more than that.
    """
    a, n, columns = dims[0], dims[1], width(bank)
    first, begin, score, information, more, heard, room = places(bank)
    own = bank[heard + channel * HEARD :][:HEARD]
    counts = not math.isnan(value)
    if counts and not used:
        counts = limit > 0.0 and value != own[VALUE] and _errs(bank, channel)
        if counts and own[REFUSED] == 0.0 and likeliest(bank, int(0), time_s) < 0.0:
            begin_window(bank, int(0), time_s)  # it is when readings are refused first that faults may have begun
    own[VALUE] = own[VALUE] if math.isnan(value) else value
    table, D = bank[first:begin].reshape((-1, TABLE)), shaped(bank[begin:score], n, columns)
    G = shaped(bank[room : room + a * columns], a, columns)
    Z = shaped(bank[room + a * columns :][: a * columns], a, columns)
    iH, iK, iS, iv = at[0], at[1], at[5], at[8]
    c = int(bank[SIGNATURES])
    for k in range(c):
        if table[k, KIND] == DRIFT:
            for w in range(WINDOWS):
                D[int(table[k, PLACE]), w * c + k] += time_s - bank[READ_S]
    bank[READ_S] = time_s
    velocity = flat(scratch(np.float64, int(1), 3))
    for j in range(3):
        felt = nav[6 + j] * nav[3] + nav[9 + j] * nav[4] + nav[12 + j] * nav[5]
        own[THEN + 6 + j] = consistency.held_slope(felt, own[THEN + 6 + j], band)
    for j in range(3):
        velocity[j] = 0.0
        for k in range(3):
            velocity[j] += nav[6 + 3 * j + k] * own[THEN + 6 + k]
    # what a unit of each of its signatures adds to the velocity over ground
    slopes = scratch(np.float64, table.shape[0], 3)
    for k in range(table.shape[0]):
        kind, place = int(table[k, KIND]), int(table[k, PLACE])
        if table[k, CHANNEL] == channel:
            for j in range(3):
                slopes[k, j] = velocity[j] if kind == SCALE else -1.0 if j == place else 0.0
            if kind == DESCRIBED:
                description_slope(place, nav, velocity, own[THEN:] if used else motion, slopes[k])
    for i in range(a):
        row, seen = G[i], not math.isnan(mem[iv + 3 + a + i])
        if not seen:
            for k in range(columns):
                row[k] = 0.0
            continue
        weighted(mem[iH + i * n : iH + (i + 1) * n], D, row)
        for k in range(table.shape[0]):
            if table[k, CHANNEL] != channel:
                continue
            kind, place = int(table[k, KIND]), int(table[k, PLACE])
            unit = 0.0
            if kind in (STEP, RAMP):
                unit = 1.0 if i == place else 0.0
            elif kind != STATE and i < table[k, READ]:
                unit = near[i, 3] * slopes[k, 0] + near[i, 4] * slopes[k, 1] + near[i, 5] * slopes[k, 2]
            if k >= c:
                row[WINDOWS * c + k - c] += unit
                continue
            for w in range(WINDOWS):
                aged = kind in (RAMP, FLOW_RAMP)
                row[w * c + k] += unit * (time_s - bank[ONSETS + w]) if aged else unit
    for i in range(3):
        own[THEN + i] = consistency.held_slope(motion[i], own[THEN + i], consistency.HELD * bank[RATE_SD])
        own[THEN + 3 + i] = motion[3 + i]
    weight = 1.0
    if used:
        own[REFUSED] = 0.0
    elif counts:
        weight = math.sqrt(_refused(own, mem, dims, at, limit))
    if counts:
        now, scaled = larger(own), shaped(bank[room + 2 * a * columns :], a, columns)
        own[READINGS] += 1.0
        for i in range(a):
            weighted(mem[iS + (a + i) * a : iS + (a + i + 1) * a], G, Z[i])
            if i < AXES and not math.isnan(mem[iv + 3 + a + i]):
                own[SUMS + i] += weight * mem[iv + 3 + i] / math.sqrt(mem[iv + 3 + a + i])
            for w in range(WINDOWS + 1):
                share = weight / math.sqrt(own[BEFORE + w] if own[BEFORE + w] > 0.0 else now)
                begins, ends, column = signatures_of(bank, w)
                for k in range(column, column + ends - begins):
                    Z[i, k] *= share
                    scaled[i, k] = share * G[i, k]
                    if not math.isnan(mem[iv + 3 + a + i]):
                        bank[score + k] += Z[i, k] * mem[iv + 3 + i] * share
        add_product(shaped(bank[information:more], columns, columns), Z, scaled)
    if used:
        few, before = flat(scratch(np.float64, int(1), a)), bank[room + 3 * a * columns :][:columns]
        for j in range(n):
            for i in range(a):
                few[i] = 2.0 * mem[iK + j * a + i]
            symmetric.copy(D[j], before)
            less_half(before, few, G, D[j])
        _turn(D, mem[at[4] : at[5]])


@njit(cache=True, **UNCOUNTED)
def _errs(bank, channel):
    """Whether a sensor has signatures of its own: what nothing else explains is its error then."""
    first, found = places(bank)[0], False
    for k in range(int(bank[SIGNATURES])):
        found |= bank[first + k * TABLE + CHANNEL] == channel
    return found


@njit(cache=True, **UNCOUNTED)
def _refused(own, mem, dims, at, limit):
    """What a reading that its gate has refused counts for [1].

    A gross error is likelier than what is beyond the gate: its variance is what the gate would let by (Huber, 1964).
    And it corrects nothing, so those that follow are off by the same error of the state: n of them, of variance R each,
    know no more than n / (R + n H P H') together.
    """
    a, n, known = dims[0], dims[1], 0.0
    beyond = max(mem[at[8]] / limit, 1.0)
    for i in range(a):
        S = mem[at[8] + 3 + a + i]
        if not math.isnan(S):
            seen = 0.0
            for j in range(n):
                seen += mem[at[6] + i * n + j] * mem[at[0] + i * n + j]
            known = max(known, seen / max(beyond * S - seen, 1e-300))
    own[REFUSED] += known
    return (1.0 + known) / ((1.0 + own[REFUSED]) * (1.0 + own[REFUSED] - known) * beyond)


@njit(cache=True, **UNCOUNTED)
def _turn(D, turn):
    """What the filter's errors count from has changed with the state: heading, velocity and tilts, as in a record for
    the smoother (`kalman.smooth_record`).
    """
    z, p, q = 0.5 * turn[0], 0.5 * turn[4], 0.5 * turn[5]
    for k in range(D.shape[1]):
        x, y, h = D[6, k], D[7, k], D[8, k]
        x, y = x - z * y, y + z * x
        D[3, k] -= turn[2] * h - turn[3] * y
        D[4, k] -= turn[3] * x - turn[1] * h
        D[5, k] -= turn[1] * y - turn[2] * x
        D[6, k], D[7, k], D[8, k] = x + q * h, y - p * h, h + p * y - q * x


@njit(cache=True, **UNCOUNTED)
def explained(J, s, variance, L, u):
    """What an error of sizes of this variance adds to the log likelihood [nat]; J, s: of its columns. The inverse of M,
    the covariance of the sizes, becomes a product of triangles L L', and u L^-1 s.
    """
    gain = 0.0
    for i in range(len(s)):
        u[i] = s[i]
        for j in range(i + 1):
            L[i, j] = J[i, j] + (1.0 / variance if i == j else 0.0)
            for r in range(j):
                L[i, j] -= L[i, r] * L[j, r]
            L[i, j] = math.sqrt(max(L[i, i], 1.0 / variance)) if i == j else L[i, j] / L[j, j]
        for j in range(i):
            u[i] -= L[i, j] * u[j]
        u[i] /= L[i, i]
        gain += 0.5 * (u[i] ** 2 - math.log(L[i, i] ** 2 * variance))
    return gain


@njit(apart=True, cache=True, **UNCOUNTED)
def judged(bank, window, k, time_s, out):
    """What innovations say of the fault that begins with signature k, with its onset in a window: its log odds against
    none, or against a description that is right [nat]; the size of what it has done to the position if it is there, the
    sd of that along its longest axis [m]; and the same of the heading [rad]. out (5,).
    """
    n, columns, (begins, _, column) = int(bank[STATES]), width(bank), signatures_of(bank, window)
    first, begin, score, information, more, _, _ = places(bank)
    own, at, age_s = first + k * TABLE, column + k - begins, max(time_s - bank[ONSETS + window], 1.0)
    together, J = int(bank[own + TOGETHER]), shaped(bank[information:more], columns, columns)
    # a ramp has come to as much as a step by now, whenever it began
    V = bank[own + VARIANCE] / (age_s**2 if bank[own + KIND] in (RAMP, FLOW_RAMP, DRIFT) else 1.0)
    L, u, s = scratch(np.float64, int(3), 3), flat(scratch(np.float64, int(1), 3)), bank[score + at :][:together]
    none = explained(J[at:, at:], s, V * RIGHT**2, L, u) if bank[own + KIND] == DESCRIBED else 0.0
    out[0] = explained(J[at:, at:], s, V, L, u) - none + bank[own + RATE] + bank[more + at]
    out[0] += math.log(age_s) if window < WINDOWS else 0.0
    D = shaped(bank[begin:score], n, columns)
    # rows of D for north, east and heading times L'^-1: of what it has done, mean by u and covariance by themselves
    by = scratch(np.float64, int(3), 3)
    for r in range(3):
        for i in range(together):
            by[r, i] = D[8 if r == 2 else r, at + i]
            for j in range(i):
                by[r, i] -= L[i, j] * by[r, j]
            by[r, i] /= L[i, i]
    north, east, turned, a, b, e, spread = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(together):
        north, east, turned = north + by[0, i] * u[i], east + by[1, i] * u[i], turned + by[2, i] * u[i]
        a, b, e = a + by[0, i] ** 2, b + by[0, i] * by[1, i], e + by[1, i] ** 2
        spread += by[2, i] ** 2
    out[1], out[2] = math.hypot(north, east), math.sqrt(0.5 * (a + e) + math.hypot(0.5 * (a - e), b))
    out[3], out[4] = abs(turned), math.sqrt(spread)


@njit(apart=True, cache=True, **UNCOUNTED)
def likeliest(bank, window, time_s):
    """Log odds of the likeliest fault of a window [nat]."""
    best, first, out = -math.inf, places(bank)[0], flat(scratch(np.float64, int(1), int(5)))
    begins, ends, _ = signatures_of(bank, window)
    for k in range(begins, ends):
        if bank[first + k * TABLE + TOGETHER] > 0.0:
            judged(bank, window, k, time_s, out)
            best = max(best, out[0])
    return best


@njit(apart=True, cache=True, **UNCOUNTED)
def begin_window(bank, window, time_s):
    """Faults of a window begin now."""
    columns, (begins, ends, column) = width(bank), signatures_of(bank, window)
    first, begin, _, _, more, heard, _ = places(bank)
    bank[ONSETS + window] = time_s
    for i in range(int(bank[CHANNELS])):
        own = bank[heard + i * HEARD :][:HEARD]
        own[BEFORE + window] = larger(own) if own[TOLD] >= DOUBTED + CONFIRMED else 0.0
    for k in range(begins, ends):
        at = column + k - begins
        forget(bank, at)
        bank[more + at] = 0.0
        if bank[first + k * TABLE + KIND] == STATE:
            bank[begin + int(bank[first + k * TABLE + PLACE]) * columns + at] = 1.0


@njit(cache=True, **UNCOUNTED)
def forget(bank, at):
    """A column has done nothing to the state, and innovations have told nothing of it."""
    n, columns = int(bank[STATES]), width(bank)
    _, begin, score, information, _, _, _ = places(bank)
    bank[score + at] = 0.0
    for i in range(n):
        bank[begin + i * columns + at] = 0.0
    for j in range(columns):
        bank[information + at * columns + j] = 0.0
        bank[information + j * columns + at] = 0.0


@njit(cache=True, **UNCOUNTED)
def _told(own):
    """What the readings of a channel since the last look tell of its error model."""
    if own[READINGS] == 0.0:
        return
    square, product, axes = 0.0, 0.0, 0
    for i in range(SUMS, SUMS + AXES):
        if own[i] != 0.0:
            mean = max(-MOST, min(own[i] / math.sqrt(own[READINGS]), MOST))
            square, product, axes = square + mean**2, product + mean * own[i + AXES], axes + 1
            own[i], own[i + AXES] = 0.0, mean
    if axes > 0:
        own[TOLD] = min(own[TOLD] + 1.0, MEMORY)
        own[SQUARE] += (square / axes - own[SQUARE]) / own[TOLD]
        own[PRODUCT] += (product / axes - own[PRODUCT]) / own[TOLD]
    own[READINGS] = 0.0


@njit(apart=True, cache=True, **UNCOUNTED)
def look(bank, time_s):
    """Log odds of the likeliest fault. That and what faults that nobody has noticed may have done to position and
    heading stand in the head then; the onset of a window that says nothing is moved on when it is its turn.
    """
    most, turn, out = -math.inf, int(bank[LOOKS]), flat(scratch(np.float64, int(1), int(5)))
    first, heard = places(bank)[0], places(bank)[5]
    for i in range(int(bank[CHANNELS])):
        _told(bank[heard + i * HEARD :][:HEARD])
    bank[RADIUS_M], bank[HEADING_RAD] = 0.0, 0.0
    for w in range(WINDOWS + 1):
        best, (begins, ends, _) = -math.inf, signatures_of(bank, w)
        for k in range(begins, ends):
            if bank[first + k * TABLE + TOGETHER] > 0.0:
                judged(bank, w, k, time_s, out)
                if out[0] > best:
                    best = out[0]
                # no further with a fault of this probability than with the risk in all (Rayleigh's distribution); what
                # is described is not in doubt
                share = 1.0 / (1.0 + math.exp(-out[0])) / RISK
                if share > 1.0 and turn >= CONFIRMED and w < WINDOWS:
                    sds = math.sqrt(2.0 * math.log(share))
                    bank[RADIUS_M] = max(bank[RADIUS_M], out[1] + sds * out[2])
                    bank[HEADING_RAD] = max(bank[HEADING_RAD], out[3] + sds * out[4])
        if w < WINDOWS and (turn < CONFIRMED or (turn % 2 ** (w + 1) == 2**w and best < 0.0)):
            begin_window(bank, w, time_s)
        if turn >= CONFIRMED and best > most:
            most = best
    bank[LOOKS], bank[LOOKED_S], bank[ODDS] = turn + 1.0, time_s, most
    return most
