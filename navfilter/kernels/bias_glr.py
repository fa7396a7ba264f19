"""Which single jump explains the innovations: of a bias of the drive, or of the offset of a sensor.

Generalised likelihood ratio of Willsky and Jones (1976). A jump of one unit at a known time makes an error f in the
state (true minus estimated, like all errors in the kernels of the filter) that the filter carries and corrects without
knowing of it; it shows as a mean of the innovations, ``H f``, and u more where the jump is in the sensor that is read.
With the innovations' own covariance S, the best size of the jump is d / c, and twice its log likelihood ratio d^2 / c.

``bank`` (J + 2, n + 3): one row a hypothesis, the drive's axes first: f (n), then d and c; in the row of a sensor's
first axis the running mean of its NIS over many windows. The last two rows are work space, but for the very last place:
there stands the NIS of all readings of this window; and its places before belong to the caller.
"""

import math

from navfilter.kernels.compiling.decorators import njit

NIS_READINGS = 200.0  # memory of the running mean of a sensor's NIS
NIS_MOST = 9.0  # what one reading adds to it at most, for a component: a fault is no noise
AXES = 6


@njit(cache=True, error_model="numpy")
def propagate_jumps(bank, Phi):
    """Carry the errors over a compound transition (m, m) of the drive."""
    _carry(bank, Phi, int(0), Phi.shape[0])


@njit(cache=True, error_model="numpy")
def update_jumps(bank, mem, dims, places, offset, says):
    """Take a reading, as the filter left it in its channel's memory (see ``kalman.memory_offsets``); returns the
    largest
    likelihood ratio of the drive's axes.

    offset: row of the hypothesis that the sensor's first axis has jumped. says: whether the reading says anything; one
    that repeats the last one to the bit may be none. A sensor whose NIS is larger than 1 for long is noisier than it
    says, and believed accordingly.
    """
    a, n, m, b, start = dims[0], dims[1], dims[2], dims[3], dims[4]
    _carry(bank, mem[: m * m].reshape((m, m)), int(0), m)
    if b > 0:
        _carry(bank, mem[m * m : m * m + b * b].reshape((b, b)), start, b)
    iH, iK, iS, iv = places[0], places[1], places[5], places[8]
    nis, used = mem[iv], mem[iv + 2] != 0.0
    if not (mem[iv + 1] > 0.0 and nis < math.inf):
        return 0.0
    believed = max(1.0, bank[offset, n + 2])
    bank[offset, n + 2] += (min(nis / mem[iv + 1], NIS_MOST) - bank[offset, n + 2]) / NIS_READINGS
    rows, largest = bank.shape[0] - 2, 0.0
    if says:
        bank[rows + 1, n + 2] += nis / believed
    y = bank[rows]
    for j in range(rows):
        f = bank[j]
        for i in range(a):
            y[i] = 0.0
            if not math.isnan(mem[iv + 3 + a + i]):
                if j == offset + i:
                    y[i] = 1.0
                for s in range(n):
                    y[i] += mem[iH + i * n + s] * f[s]
        for i in range(a):
            z = 0.0
            for r in range(a):
                z += mem[iS + (a + i) * a + r] * y[r]
            if says and not math.isnan(mem[iv + 3 + a + i]):
                f[n + 1] += z * y[i] / believed
                f[n] += z * mem[iv + 3 + i] / believed
        if used:
            for s in range(n):
                for i in range(a):
                    f[s] -= mem[iK + s * a + i] * y[i]
        if j < AXES and f[n + 1] > 0.0:
            largest = max(largest, f[n] * f[n] / f[n + 1])
    return largest


@njit(cache=True, error_model="numpy")
def _carry(bank, Phi, start, size):
    """f <- Phi f for the `size` states from `start`."""
    rows = bank.shape[0] - 2
    work = bank[rows]
    for j in range(rows):
        f = bank[j]
        for i in range(size):
            s = 0.0
            for r in range(size):
                s += Phi[i, r] * f[start + r]
            work[i] = s
        for i in range(size):
            f[start + i] = work[i]
