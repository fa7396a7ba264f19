"""What the samples of an inertial unit say about themselves: axes that stick, are dead, clip, become noisy, or feel
gravity where it is not.

``w`` (7, 18) is all that is remembered. Rows 0 to 5 are the axes (three gyros, three accelerometers), with the columns
below; row 6 belongs to the unit as a whole. Values are compared as they come (a sample that repeats does so to the
bit); everything else is in rates and forces.
"""

import math

from navfilter.kernels.compiling.decorators import UNCOUNTED, njit

# Columns of an axis: its condition, how long that had lasted when it was found [s] and how long nothing has spoken for
# it [s]; the last value as it came, times it came in a row, share of values that repeat, smallest change; the last two
# as rates, largest magnitude; variance of second differences now and usually, samples seen; mean over 0.1 s; spikes so
# far and the size of the last. The last columns belong to the filter: the condition that it has heeded, and the white
# variance that it believes in (0: that of the description).
CODE, BEGAN_S, CLEAN_S, RAW, RUN, REPEATS, QUANTUM, LAST, BEFORE, EXTREME = range(10)
NOISE, USUAL, SEEN, MEAN, SPIKES, SIZE, HEEDED, WHITE, COLUMNS = range(10, 19)
# Places in the row of the unit: samples since its attitude was asked for, whether something is to be looked at, how
# long gravity has been off, and been close [s]; whether the reference may be judged by; the reference: specific force
# at rest in b (3) [m/s^2]; gravity [m/s^2]; sines of the most that the vehicle has rolled, and pitched.
UNIT = 6
TICK, NEWS, OFF_S, CLOSE_S, SURE, REFERENCE, GRAVITY, TILTED = 0, 1, 2, 3, 4, 5, 8, 9

# Conditions. Beyond `NOISY` nothing of an axis is used; from `MISPLACED` to `IN_G` it is gravity that says so. The last
# two are set by others, and `CONTRADICTED` is ended by them, too.
GOOD, NOISY, STUCK, DEAD, SATURATED, ERRATIC, WRONG_UNIT = range(7)
MISPLACED, FREE_FALL, SWAPPED, IN_G, CONTRADICTED, SILENT = range(7, 13)

FALSE_ALARM = math.log(1e-12)  # of a run of equal values, per sample and axis: one in 80 years at 100 Hz
LEAST_RUN, LEAST_S = 10.0, 0.1  # a bus repeats a few samples when it stumbles
REPEATED = 1.0 / 2000.0  # per sample: memory of the share of repeats: 20 s at 100 Hz
ALIVE = 0.2  # an axis that has never shown so much of its noise is no sensor: a simulation without errors
NOISE_S, USUAL_S = 0.5, 600.0  # memories of the noise: a fault shows at once, a thruster becomes usual in a minute
KNOWN_S = 10.0  # before that nobody knows what is usual
QUICK_S = 0.025  # with longer periods second differences are motion
NOISIER, QUIETER = 25.0, 9.0  # times the usual variance: 5 standard deviations begin, 3 end it
WILD = 900.0  # times the usual variance, 30 standard deviations: nothing of it can be used
DEGREES = 2025.0, 4900.0  # times the usual variance (45 to 70 standard deviations): degrees for radians are 57.3
CLIP = 16.0  # a second difference counts as at most so many times the variance: single samples are spikes
SPIKE = 12.0  # standard deviations of a single sample off both its neighbours (normal: never)
MEAN_S = 0.1
OFF, NEAR = 0.7, 0.35  # of gravity: no vehicle that swims accelerates so for `OFF_FOR_S`
OFF_FOR_S, RECOVERS_S = 0.3, 1.0
LEVEL_SD = 0.1  # gravity is held against accelerometers while roll and pitch are known to this [rad]
JUDGED_S = 1.0  # how often the attitude is asked for: between, the reference turns with the gyros


@njit(apart=True, cache=True, error_model="numpy", **UNCOUNTED)
def check_samples(samples, w, sd, limits, period_s, increments):
    """Look at samples in their order, and put what is known in place of what bad axes say: a gyro's rate is 0, an
    accelerometer's force that of a vehicle at rest.

    samples (n, 7): seconds since the one before, six values; changed in place. sd (6,): of the white noise of one rate
    (force) whose second differences would be as large as the vehicle's description says; limits (6,): where its range
    ends. Returns after how many samples something has to be looked at (``w[6, NEWS]``), or n.
    """
    unit, n = w[UNIT], 0
    unit[NEWS] = 0.0
    while n < samples.shape[0] and unit[NEWS] == 0.0:
        _check_axes(samples[n], w, sd, limits, period_s, increments)
        _turn(samples[n], w, period_s, increments)
        n += 1
    return n


@njit(cache=True, error_model="numpy", inline="always", **UNCOUNTED)
def _check_axes(sample, w, sd, limits, period_s, increments):
    """What a sample says of each axis."""
    unit, dt = w[UNIT], sample[0]
    gap = not 0.2 * period_s < dt < 3.0 * period_s
    per = 1.0 / dt if increments else 1.0
    for i in range(6):
        a = w[i]
        raw = sample[1 + i]
        x, white = raw * per, 6.0 * sd[i] * sd[i]
        # -- runs of equal values
        if raw == a[RAW] and a[SEEN] > 0.0:
            a[RUN] += 1.0
            if a[CODE] <= NOISY:  # a value that is stuck is not what is usual
                a[REPEATS] += (1.0 - a[REPEATS]) * REPEATED
        else:
            change = abs(raw - a[RAW])
            if a[SEEN] > 0.0 and change > 1e-9 * abs(raw):
                a[QUANTUM] = min(a[QUANTUM], change)
            a[RUN] = 1.0
            a[REPEATS] -= a[REPEATS] * REPEATED
            a[RAW] = raw
        # -- second differences: what no motion has, and a single sample that neither neighbour confirms
        level = max(a[NOISE], white)  # 0 where no error at all is described: then nothing is judged by it
        if a[SEEN] >= 2.0 and not gap:
            off = a[LAST] - 0.5 * (x + a[BEFORE])
            lonely = off * off > SPIKE * SPIKE * level / 6.0 > 0.0 and abs(x - a[BEFORE]) < 0.5 * abs(off)
            if lonely and a[SEEN] * period_s > KNOWN_S and a[CODE] == GOOD:
                a[SPIKES] += 1.0
                a[SIZE] = off
                unit[NEWS] = 1.0
            square = min(4.0 * off * off, CLIP * level)
            part = 1.0 / a[SEEN]
            a[NOISE] += (square - a[NOISE]) * min(1.0, max(period_s / NOISE_S, part))
            if a[RUN] < 3.0 and a[CODE] <= NOISY:
                if a[SEEN] * period_s > KNOWN_S:
                    square = min(square, CLIP * max(a[USUAL], white))
                a[USUAL] += (square - a[USUAL]) * max(period_s / USUAL_S, part if a[CODE] == GOOD else 0.0)
        a[SEEN] += 1.0
        a[BEFORE] = x if gap else a[LAST]
        a[LAST] = x
        a[MEAN] += (x - a[MEAN]) * min(1.0, max(dt / MEAN_S, 1.0 / a[SEEN]))
        # -- what that says
        found, since_s = GOOD, 0.0
        if a[RUN] >= LEAST_RUN and a[RUN] * period_s >= LEAST_S and a[USUAL] > ALIVE * ALIVE * white:
            repeats = a[REPEATS]
            if sd[i] > 0.0:
                # a value that stands in the middle of its step of quantisation repeats so often by noise alone
                steps = a[QUANTUM] / (sd[i] * (period_s if increments else 1.0))
                repeats = max(repeats, math.erf(steps / math.sqrt(8.0)) ** 2)
            if repeats < 1.0 and a[RUN] * math.log(max(repeats, 1e-300)) < FALSE_ALARM:
                found, since_s = STUCK, a[RUN] * period_s
                if raw == 0.0:
                    found = DEAD
                elif abs(x) >= a[EXTREME]:
                    found = SATURATED
        if a[RUN] >= 3.0 and abs(x) >= limits[i]:
            found, since_s = SATURATED, a[RUN] * period_s
        if a[RUN] == 1.0:
            a[EXTREME] = max(a[EXTREME], abs(x))
        usual = max(a[USUAL], white)
        again = a[CODE] == NOISY or a[CODE] == ERRATIC or a[CODE] == WRONG_UNIT
        if found == GOOD and a[SEEN] * period_s > KNOWN_S and usual > 0.0 and period_s <= QUICK_S:
            ratio = a[NOISE] / usual
            if ratio > (QUIETER if again else NOISIER):
                found, since_s = NOISY, 0.2 * NOISE_S
                if ratio > WILD or a[CODE] == ERRATIC or a[CODE] == WRONG_UNIT:
                    found = WRONG_UNIT if DEGREES[0] < ratio < DEGREES[1] else ERRATIC
        if found > NOISY or (found == NOISY and a[CODE] != SILENT):
            a[CLEAN_S] = 0.0
            # a worse one, or the same with a better name
            if a[CODE] < found and (a[CODE] <= NOISY or a[CODE] == ERRATIC):
                a[CODE], a[BEGAN_S] = found, since_s
                unit[NEWS] = 1.0
        elif a[CODE] != GOOD and (a[CODE] < MISPLACED or a[CODE] == SILENT):
            a[CLEAN_S] += dt
            if a[CLEAN_S] >= RECOVERS_S:
                a[CODE] = GOOD
                unit[NEWS] = 1.0


@njit(cache=True, error_model="numpy", inline="always", **UNCOUNTED)
def _turn(sample, w, period_s, increments):
    """Weigh what accelerometers say, leave out what bad axes say, and turn the reference on."""
    unit, dt = w[UNIT], sample[0]
    per = 1.0 / dt if increments else 1.0
    _weigh(w, dt)
    for i in range(6):
        if w[i, CODE] > NOISY:
            sample[1 + i] = 0.0 if i < 3 else unit[REFERENCE + i - 3] * (dt if increments else 1.0)
    # between two looks at the attitude the reference turns with the gyros
    r0, r1, r2 = unit[REFERENCE], unit[REFERENCE + 1], unit[REFERENCE + 2]
    p, q, r = sample[1] * per * dt, sample[2] * per * dt, sample[3] * per * dt
    unit[REFERENCE] = r0 + r1 * r - r2 * q
    unit[REFERENCE + 1] = r1 + r2 * p - r0 * r
    unit[REFERENCE + 2] = r2 + r0 * q - r1 * p
    unit[TICK] += 1.0
    if unit[TICK] * period_s >= JUDGED_S:
        unit[NEWS] = 1.0


@njit(cache=True, error_model="numpy", inline="always", **UNCOUNTED)
def _weigh(w, dt):
    """Hold the force that accelerometers say against the one at rest."""
    unit = w[UNIT]
    off, close, bad = False, True, False
    g = unit[GRAVITY]
    for i in range(3):
        a = w[3 + i]
        apart = abs(a[MEAN] - unit[REFERENCE + i])
        off = off or (a[CODE] <= NOISY and apart > OFF * g)
        close = close and apart < NEAR * g
        bad = bad or MISPLACED <= a[CODE] <= IN_G
    unit[OFF_S] = unit[OFF_S] + dt if off and unit[SURE] != 0.0 else 0.0
    unit[CLOSE_S] = unit[CLOSE_S] + dt if close else 0.0
    if unit[OFF_S] >= OFF_FOR_S or (bad and unit[CLOSE_S] >= RECOVERS_S):
        _judge(w)


@njit(apart=True, cache=True, error_model="numpy", **UNCOUNTED)
def _judge(w):
    """Say what is wrong with all three accelerometers, or that nothing is any more."""
    unit = w[UNIT]
    if unit[OFF_S] >= OFF_FOR_S:
        g, x, y, z = unit[GRAVITY], w[3, MEAN], w[4, MEAN], w[5, MEAN]
        size = math.sqrt(x * x + y * y + z * z)
        found = MISPLACED
        if size < 0.05 * g:
            found = FREE_FALL
        elif abs(size - 1.0) < 0.2:
            found = IN_G
        elif abs(size - g) < 0.2 * g:
            found = SWAPPED
        for i in range(3):
            if w[3 + i, CODE] <= NOISY:
                w[3 + i, CODE], w[3 + i, BEGAN_S] = found, OFF_FOR_S + MEAN_S
        unit[OFF_S] = 0.0
    else:
        for i in range(3):
            if MISPLACED <= w[3 + i, CODE] <= IN_G:
                w[3 + i, CODE] = GOOD
    unit[NEWS] = 1.0
