"""Which parts of a record of an inertial unit are at rest, and whether what looks like rest is a slow motion."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import ndimage, signal

from navfilter.foundation.arrays import Array, Mask
from navfilter.identification.conditioning import bridged

#: Blocks in which rest is judged [s], and at least so many samples.
BLOCK_S, BLOCK_SAMPLES = 1.0, 32
#: A block is disturbed where an axis scatters so many times more than in the quietest quarter of the record, or where
#: its mean lies so many of its usual steps from those of its neighbours.
LOUD, AWAY, NEIGHBOURS = 2.0, 12.0, 15
#: The level changes where the means of so many blocks before and behind differ by so many usual steps.
SIDE, JUMP = 7, 6.0
#: Central share of a block whose scatter counts, and what it is of that of all its samples if they are normal.
CENTRAL, CENTRAL_SD = 0.9, 0.79
#: The quarter of the smallest steps between independent normal means lies below so many of their standard deviations.
QUARTER_STEP = 0.4506
#: Gaps of fewer samples are filled with noise drawn from all others, at the level of so many around, or more.
_FEW, _AROUND = 16, 64
#: Levels that lie apart by so many of their sd wander; of a hundred of white noise few do.
_WANDERS = 6.0
#: Disturbances up to this long [s] and of this share are bridged, where the level after them is that before; others
#: part the record.
BRIDGED_S, BRIDGED_SHARE = 10.0, 0.1
#: A sample so many robust standard deviations off its neighbours is a defect, not noise.
GROSS = 20.0
#: Shortest stretch at rest that is used [s], and in samples.
SHORTEST_S, SHORTEST = 30.0, 500
#: Motion shows where gyros and accelerometers move together: frequencies looked at [Hz], segments averaged at least,
#: probability that rest is called motion, and how many neighbouring frequencies must agree.
SWAY_HZ, SEGMENTS, FALSE_ALARM, AGREEING = (0.05, 2.0), 12, 1e-4, 3


@dataclass(frozen=True, eq=False)
class Stillness:
    """Rest within a record.

    Attributes
    ----------
    stretches : tuple of (first, after)
        Samples at rest, with short disturbances inside.
    disturbed : ndarray of bool, shape (n,)
        Samples that do not count: disturbed or missing.
    share : float
        Share of the record that is at rest and used.
    """

    stretches: tuple[tuple[int, int], ...]
    disturbed: Mask
    share: float


def stillness(samples: Array, rate_hz: float, most_turn: Array | None = None) -> Stillness:
    """Find the parts at rest.

    Parameters
    ----------
    samples : ndarray, shape (n, k)
        Axes side by side, NaN where a sample is missing.
    rate_hz : float
    most_turn : ndarray, shape (k,), optional
        A stretch whose level differs by more from that of the longest is a steady motion.

    Returns
    -------
    Stillness
        Without stretches where nothing is at rest for long enough.
    """
    length = max(round(BLOCK_S * rate_hz), BLOCK_SAMPLES)
    blocks = samples.shape[0] // length
    nothing = Stillness((), np.ones(samples.shape[0], dtype=bool), 0.0)
    if blocks < 4:
        return nothing
    shaped = samples[: blocks * length].reshape(blocks, length, -1)
    quiet = np.isfinite(shaped).mean(axis=(1, 2)) > 0.5
    levels = np.full((blocks, samples.shape[1]), np.nan)
    for axis in range(samples.shape[1]):
        scatter, levels[:, axis] = _scatter(shaped[:, :, axis]), _level(shaped[:, :, axis])
        quiet &= _calm(scatter, _resolution(samples[:, axis]))
    for axis in range(samples.shape[1]):
        quiet &= _steady(levels[:, axis], quiet)
    # What begins or ends a disturbance reaches into the blocks beside it.
    quiet &= np.r_[True, quiet[:-1]] & np.r_[quiet[1:], True]
    runs = _joined(_runs(quiet), levels, max(round(BRIDGED_S * rate_hz / length), 1))
    least = max(SHORTEST_S * rate_hz, SHORTEST)
    runs = [(first, after) for first, after in runs if (after - first) * length >= least]
    if most_turn is not None and runs:
        usual = levels[slice(*max(runs, key=lambda run: run[1] - run[0]))].mean(axis=0)
        runs = [run for run in runs if np.all(np.abs(levels[slice(*run)].mean(axis=0) - usual) <= most_turn)]
    stretches = [(first * length, after * length) for first, after in runs]
    if stretches and stretches[-1][1] == blocks * length and quiet[-1]:
        stretches[-1] = (stretches[-1][0], samples.shape[0])
    disturbed = np.repeat(~quiet, length)
    disturbed = np.r_[disturbed, np.full(samples.shape[0] - disturbed.size, not quiet[-1])]
    disturbed |= ~np.isfinite(samples).all(axis=1)
    used = sum(int((~disturbed[first:after]).sum()) for first, after in stretches)
    return Stillness(tuple(stretches), disturbed, used / samples.shape[0]) if stretches else nothing


def _scatter(blocks: Array) -> Array:
    """Standard deviation of the central samples of each block, whatever a few others do."""
    ordered = np.sort(blocks, axis=1)
    known = np.isfinite(ordered).sum(axis=1)
    scatter = np.full(len(blocks), np.nan)
    for count in np.unique(known[known > 1]):
        rows = known == count
        outside = int(0.5 * (1.0 - CENTRAL) * count)
        scatter[rows] = ordered[rows, outside : count - outside].std(axis=1) / CENTRAL_SD
    return scatter


def _level(blocks: Array) -> Array:
    """Mean of each block, NaN where nothing is known."""
    known = np.isfinite(blocks)
    return np.asarray(np.where(known, blocks, 0.0).sum(axis=1) / np.where(known.any(axis=1), known.sum(axis=1), np.nan))


def _resolution(x: Array) -> float:
    """Smallest step between samples: less scatter than half of it is not seen."""
    values = np.unique(x[np.isfinite(x)][:100_000])
    return float(np.diff(values).min()) if values.size > 1 else 0.0


def _calm(scatter: Array, resolution: float) -> Mask:
    known = scatter[np.isfinite(scatter)]
    if known.size == 0:
        return np.zeros(scatter.size, dtype=bool)
    return np.asarray(scatter <= LOUD * max(float(np.quantile(known, 0.25)), 0.5 * resolution))


def _steady(level: Array, quiet: Mask) -> Mask:
    """Whether the mean of each block is that of its quiet neighbours, on both sides."""
    places = np.flatnonzero(quiet)
    steady = np.zeros(level.size, dtype=bool)
    steady[places] = True
    if places.size < NEIGHBOURS:
        return steady
    x = level[places]
    scatter = float(np.quantile(np.abs(np.diff(x)), 0.25)) / QUARTER_STEP
    windows = np.lib.stride_tricks.sliding_window_view(np.pad(x, NEIGHBOURS // 2, mode="reflect"), NEIGHBOURS)
    steady[places] = np.abs(x - np.median(windows, axis=1)) <= AWAY * scatter
    sums = np.cumsum(np.r_[0.0, x - x[0]])
    change = np.abs(sums[2 * SIDE :] - 2.0 * sums[SIDE:-SIDE] + sums[: -2 * SIDE]) / SIDE
    jumps = np.flatnonzero(change > JUMP * scatter) + SIDE
    # of the blocks around a jump, the two between which it is largest
    for group in np.split(jumps, np.flatnonzero(np.diff(jumps) > 1) + 1) if jumps.size else []:
        steepest = int(group[np.argmax(change[group - SIDE])])
        steady[places[steepest - 1 : steepest + 1]] = False
    return steady


def _runs(quiet: Mask) -> list[tuple[int, int]]:
    edges = np.flatnonzero(np.diff(np.r_[False, quiet, False].astype(np.int8)))
    return [(int(first), int(after)) for first, after in zip(edges[::2], edges[1::2], strict=True)]


def _joined(runs: list[tuple[int, int]], levels: Array, longest: int) -> list[tuple[int, int]]:
    """Runs of quiet blocks with short disturbances inside, where the level did not change."""
    joined: list[tuple[int, int]] = []
    for first, after in runs:
        if joined and _is_short(joined[-1], (first, after), longest) and _same(levels, joined[-1], (first, after)):
            joined[-1] = (joined[-1][0], after)
        else:
            joined.append((first, after))
    return joined


def _is_short(before: tuple[int, int], after: tuple[int, int], longest: int) -> bool:
    gap = after[0] - before[1]
    return gap <= longest and gap <= BRIDGED_SHARE * (after[1] - before[0])


def _same(levels: Array, before: tuple[int, int], after: tuple[int, int]) -> bool:
    one = levels[max(before[0], before[1] - NEIGHBOURS) : before[1]]
    other = levels[after[0] : min(after[1], after[0] + NEIGHBOURS)]
    spread = np.sqrt(one.var(axis=0) + other.var(axis=0))
    return bool(np.all(np.abs(one.mean(axis=0) - other.mean(axis=0)) <= np.maximum(3.0 * spread, 1e-300)))


def moving_together(gyro: Sequence[Array], accel: Sequence[Array], rate_hz: float) -> tuple[str, ...]:
    """Pairs of a gyro and an accelerometer that move together at frequencies of a swell, a mooring or a hand.

    A unit's own noise is independent from axis to axis; a motion is not.

    Parameters
    ----------
    gyro, accel : sequence of ndarray, shape (n,)
        The axes x, y, z of one stretch.
    rate_hz : float

    Returns
    -------
    tuple of str
        Such as ``"gyro y and accel x from 0.1 to 0.3 Hz"``, the closest first; empty for a unit at rest.
    """
    if not (gyro and accel):
        return ()
    factor = max(int(rate_hz / (8.0 * SWAY_HZ[1])), 1)
    slow = rate_hz / factor
    size = int(min(20.0 * slow, gyro[0].size // factor * 2 // (SEGMENTS + 1)))
    if size < 5.0 * slow:
        return ()
    found = []
    for i, one in enumerate(gyro):
        for j, other in enumerate(accel):
            a, b = (x[: x.size // factor * factor].reshape(-1, factor).mean(axis=1) for x in (one, other))
            frequency, coherence = signal.coherence(a, b, slow, nperseg=size, detrend="linear")
            inside = (frequency >= SWAY_HZ[0]) & (frequency <= SWAY_HZ[1])
            # Half overlapping segments with Hann's window count for 0.95 of independent ones of half the number.
            segments = 0.95 * (a.size / size * 2.0 - 1.0) / (1.0 + 2.0 * (1.0 / 6.0) ** 2)
            limit = 1.0 - (FALSE_ALARM / 9.0 / inside.sum()) ** (1.0 / (segments - 1.0))
            places = np.flatnonzero(inside & (coherence > limit))
            runs = [run for run in np.split(places, np.flatnonzero(np.diff(places) > 1) + 1) if run.size >= AGREEING]
            if runs:
                run = max(runs, key=len)
                words = (
                    f"gyro {'xyz'[i]} and accel {'xyz'[j]} from {frequency[run[0]]:.2g} to {frequency[run[-1]]:.2g} Hz"
                )
                found.append((float(coherence[run].mean()), words))
    return tuple(words for _, words in sorted(found, reverse=True))


def without_defects(value: Array) -> tuple[Array, list[str]]:
    """Samples with single defects made missing."""
    samples, count = value.copy(), 0
    for x in samples.T:
        if not np.isfinite(x).any():
            continue
        away = np.abs(x - ndimage.median_filter(bridged(x), 5, mode="nearest"))
        limit = GROSS * 1.4826 * float(np.nanmedian(away))
        far = away > limit if limit > 0.0 else np.zeros(x.size, dtype=bool)
        # A handful is a defect; many are a motion, which is for the blocks to judge.
        if 0 < far.sum() < 1e-3 * x.size + 3:
            count += int(far.sum())
            x[far] = np.nan
    notes = [f"{count} samples beyond {GROSS:g} robust standard deviations count as missing"] if count else []
    missing = int((~np.isfinite(value)).any(axis=1).sum())
    return samples, notes + ([f"{missing} of {len(samples)} samples are missing"] if missing else [])


def bridged_rest(x: Array, gone: Mask) -> Array:
    """A stretch with what is gone replaced at the level of its neighbours: by the noise before it (behind it at the
    beginning), or, where only a few samples are gone, by noise drawn from the others. Copied with their mean taken out,
    few samples would have less noise than the rest.
    """
    x = x.copy()
    edges = np.flatnonzero(np.diff(np.r_[False, gone, False].astype(np.int8)))
    drawn = _drawn(x, gone)
    for first, after in zip(edges[::2], edges[1::2], strict=True):
        size = after - first
        if size < _FEW:
            x[first:after] = drawn[first:after]
            continue
        source = x[first - size : first] if first >= size else x[after : after + size]
        if source.size < size or (gone[after : after + size].any() and first < size):
            known = np.flatnonzero(~gone)
            x[first:after] = np.interp(np.arange(first, after), known, x[known])
            continue
        around = max(size, 32)
        before, behind = x[max(first - around, 0) : first], x[after : after + around][~gone[after : after + around]]
        ends = [part.mean() if part.size else source.mean() for part in (before, behind)]
        x[first:after] = source - source.mean() + np.linspace(ends[0], ends[1], size)
    return x


def _drawn(x: Array, gone: Mask) -> Array:
    """For every sample another one of the same noise: the level around it, and how far some other is from its own."""
    known = np.where(gone, 0.0, x)
    around = _steady_for(x[~gone])
    if around >= np.count_nonzero(~gone):
        count, total = np.full(x.size, float(np.count_nonzero(~gone))), np.full(x.size, known.sum())
    else:
        count, total = (
            ndimage.uniform_filter1d(part, around, mode="nearest") * around for part in ((~gone).astype(float), known)
        )
    level = total / np.maximum(count, 1.0)
    here = np.flatnonzero(~gone & (count > 1.5))
    if not here.size:
        return np.asarray(level)
    # a sample is nearer to a level that it is part of itself
    apart = (x[here] - level[here]) / np.sqrt(1.0 - 1.0 / count[here])
    return np.asarray(level + np.random.default_rng(0).choice(apart, x.size))


def _steady_for(x: Array) -> int:
    """Over how many samples the level is that of white noise: levels of few samples scatter, and what is filled in with
    them would be slow noise.
    """
    sd = float(np.std(np.diff(x))) / np.sqrt(2.0) if x.size > 2 else 0.0
    around = _AROUND
    while 4 * around <= x.size:
        blocks = x[: x.size // (2 * around) * 2 * around].reshape(-1, 2 * around).mean(axis=1)
        if np.ptp(blocks) > _WANDERS * sd / np.sqrt(2.0 * around):
            return around
        around *= 2
    return max(around, x.size) if 4 * around > x.size else around
