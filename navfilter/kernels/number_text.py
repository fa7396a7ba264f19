"""Numbers as text, to the last character as Python's ``%`` writes them, and many times as quickly."""

import math

import numpy as np

from navfilter.kernels.compiling.decorators import UNCOUNTED, njit

ZERO, POINT, MINUS, PLUS, EXPONENT, COMMA, END = 48, 46, 45, 43, 101, 44, 10  # characters
WIDEST = 32  # characters of a number with its comma, at most
LARGEST = 1e15  # whole numbers up to here are doubles, and their parts are exact
SMALLEST = 290  # powers of ten up to here and down to its inverse are far from where doubles end
POWERS = np.array([float(f"1e{power}") for power in range(-SMALLEST - 20, SMALLEST + 20)])
UNIT = SMALLEST + 20  # where the power 0 stands
TEN = np.uint64(10)  # without signs a division by it is a multiplication
#: Digits come from a product that is off by a millionth of a unit at most: nearer to a tie than this is left to Python.
DOUBT = 1e-5


@njit(cache=True, error_model="numpy", **UNCOUNTED)
def _whole(number, count, out, at):
    """So many digits of a whole number, with zeros before it."""
    left = np.uint64(number)
    for i in range(at + count - 1, at - 1, -1):
        more = left // TEN
        out[i] = ZERO + np.int64(left - more * TEN)
        left = more
    return at + count


@njit(cache=True, error_model="numpy", **UNCOUNTED)
def _without_zeros(out, end):
    """Where a number with a point ends without the zeros behind it, and without a point that nothing follows."""
    while out[end - 1] == ZERO:
        end -= 1
    return end - 1 if out[end - 1] == POINT else end


@njit(cache=True, error_model="numpy", **UNCOUNTED)
def _fixed(x, decimals, out, at):
    """As ``%.{decimals}f``; -1 where this is not sure of the last digit."""
    size = abs(x)
    if not size < LARGEST:
        return -1
    before = math.floor(size)
    part = (size - before) * POWERS[UNIT + decimals]
    behind = math.floor(part)
    if abs(part - behind - 0.5) < DOUBT:
        return -1
    if part - behind > 0.5:
        behind += 1.0
    if behind >= POWERS[UNIT + decimals]:
        behind = 0.0
        before += 1.0
    if math.copysign(1.0, x) < 0.0:
        out[at] = MINUS
        at += 1
    count = 1
    while before >= POWERS[UNIT + count]:
        count += 1
    at = _whole(before, count, out, at)
    out[at] = POINT
    return _whole(behind, decimals, out, at + 1)


@njit(cache=True, error_model="numpy", **UNCOUNTED)
def _general(x, figures, out, at):
    """As ``%.{figures}g``; -1 where this is not sure of the last digit."""
    size = abs(x)
    if size == 0.0:
        if math.copysign(1.0, x) < 0.0:
            out[at] = MINUS
            at += 1
        out[at] = ZERO
        return at + 1
    if not POWERS[UNIT - SMALLEST] < size < POWERS[UNIT + SMALLEST]:
        return -1
    power = int(math.floor(math.log10(size)))
    low, high = POWERS[UNIT + figures - 1], POWERS[UNIT + figures]
    digits = size * POWERS[UNIT + figures - 1 - power]
    if digits < low:
        power -= 1
        digits = size * POWERS[UNIT + figures - 1 - power]
    elif digits >= high:
        power += 1
        digits = size * POWERS[UNIT + figures - 1 - power]
    number = math.floor(digits)
    if abs(digits - number - 0.5) < DOUBT:
        return -1
    if digits - number > 0.5:
        number += 1.0
    if number >= high:
        number = low
        power += 1
    if x < 0.0:
        out[at] = MINUS
        at += 1
    if power < -4 or power >= figures:
        return _scientific(number, figures, power, out, at)
    if power < 0:
        out[at], out[at + 1] = ZERO, POINT
        for i in range(-power - 1):
            out[at + 2 + i] = ZERO
        return _without_zeros(out, _whole(number, figures, out, at + 1 - power))
    end = _whole(number, figures, out, at + 1)
    for i in range(at, at + power + 1):
        out[i] = out[i + 1]
    out[at + power + 1] = POINT
    return _without_zeros(out, end)


@njit(cache=True, error_model="numpy", **UNCOUNTED)
def _scientific(number, figures, power, out, at):
    """Digits with a point behind the first, and a power of ten."""
    end = _whole(number, figures, out, at + 1)
    out[at] = out[at + 1]
    out[at + 1] = POINT
    at = _without_zeros(out, end)
    out[at] = EXPONENT
    out[at + 1] = MINUS if power < 0 else PLUS
    size = abs(power)
    return _whole(float(size), 3 if size > 99 else 2, out, at + 2)


@njit(cache=True, error_model="numpy", **UNCOUNTED)
def rows_of_text(values, digits, marks, given, begin, out):
    """Rows of numbers from the one of number `begin` on, with commas between them and a new line behind each.

    values (n * c,); digits (c,): decimals of each column (at most ten), significant figures where negative (at most
    nine); marks (n, w): characters of a further column behind the first, none where w is 0; given: the first of the
    numbers as text, where this kernel was not sure of it; out: room for `WIDEST` characters a number, and the marks.
    Returns the number that it is not sure of, or how many there are, and how many characters were written.
    """
    columns, at = digits.size, 0
    row, column = begin // columns, begin % columns
    for k in range(begin, values.size):
        if k == begin and given.size > 0:
            for i in range(given.size):
                out[at + i] = given[i]
            end = at + given.size
        elif digits[column] >= 0:
            end = _fixed(values[k], digits[column], out, at)
        else:
            end = _general(values[k], -digits[column], out, at)
        if end < 0:
            return k, at
        at = end
        if column == 0 and marks.shape[1] > 0:
            out[at] = COMMA
            for i in range(marks.shape[1]):
                out[at + 1 + i] = marks[row, i]
            at += 1 + marks.shape[1]
        column += 1
        out[at] = COMMA if column < columns else END
        at += 1
        if column == columns:
            row, column = row + 1, int(0)
    return values.size, at
