"""Broken inputs made out of valid ones, for `fuzz.py`."""

from __future__ import annotations

import random
import re

from navfilter.io.mission_schema import groups
from navfilter.io.units import SUFFIXES, UNITS

VOCABULARY = """
name drive sensors type model error imu dead-reckoning heading body-velocity depth position zero-velocity white
random-walk gauss-markov arma learned-arma adopted prior orders window hop ar ma sd density start_sd tau_s order
rate_hz gyro accel tilt attitude velocity lever_arm_b_m mounting_deg scale_sd streams truth start file time column
columns unit axes constant mean invalid invalid_above valid_range sources only_changes average every resample_hz hide
windows zero_s first from date log sensor time_s value rate_b force_b event bad lost latitude_deg longitude_deg
heading_deg position_sd_m table transpose delimiter decimal comment skip_lines skip_rows header max_gap_s rollover
ends_only iso8601 reference ecef enu order wxyz
"""
#: Words that mean something to one of the readers.
WORDS = [*VOCABULARY.split(), *groups(), *(unit for unit in UNITS if unit), *(f"sd_{suffix}" for suffix in SUFFIXES)]
NUMBERS = """
0 -0.0 1 -1 2 3 4 7 10 0.5 -2.5 100 1e-3 1e-9 1e-300 5e-324 1e9 1e12 1e20 1e300 1.7976931348623157e308 1e400 -1e400
inf -inf nan 9223372036854775807 9223372036854775808 -9223372036854775809 99999999999999999999999 0x7f 0b1 1_000 00 1e
1. .5 +1 1e-400 180 360 2026-06-01 2026-13-01 0000-00-00 12:00:00 2026-06-01T00:00:00Z true false null NaN Infinity
"""
PIECES = [
    *rb"[[[[ ]]]] {{ }} [] {} = == , ,, ; : . .. # % $ ${X} $HOME".split(),
    *(b'"', b'"""', b"'", b"'''", b"\\", b"\\u0000", b"\\ud800", b" "),
    *b"\x00 \xff \xef\xbb\xbf \xc3\x28 \r \r\n \t \n\n\n".split(b" "),
    *(b"[" * 500, b'{"a":' * 500, b"9" * 5000, b"x" * 70000),
    "é日本\u2028\U0001f600".encode(),
]
TOKEN = re.compile(rb'"[^"\n]*"|[+-]?[0-9][0-9A-Za-z_.+:-]*|[A-Za-z_][A-Za-z0-9_-]*|[\[\]{}=,:;#]')


class Mutator:
    """Makes broken inputs out of valid ones.

    Parameters
    ----------
    examples : list of bytes
    text : bool
        Whether tokens and lines mean something.
    """

    def __init__(self, examples: list[bytes], text: bool) -> None:
        self.examples, self.text = examples, text

    def make(self, rng: random.Random, given: bytes | None = None) -> bytes:
        """One input: an example (or the one given) after one to eight mutations."""
        data = rng.choice(self.examples) if given is None else given
        for _ in range(min(1 + int(rng.expovariate(1.2)), 8)):
            data = self._token(data, rng) if self.text and rng.random() < 0.75 else self._bytes(data, rng)
        return data[:200_000]

    def _bytes(self, data: bytes, rng: random.Random) -> bytes:
        if not data:
            return rng.choice(PIECES)
        a = rng.randrange(len(data))
        b = min(len(data), a + rng.choice((1, 1, 2, 4, 8, 64, 1000)))
        match rng.randrange(7):
            case 0:
                return data[:a] + bytes([data[a] ^ (1 << rng.randrange(8))]) + data[a + 1 :]
            case 1:
                return data[:a] + rng.randbytes(b - a) + data[b:]
            case 2:
                return data[:a] + data[b:]
            case 3:
                return data[:a] + data[a:b] * rng.choice((2, 3, 50)) + data[b:]
            case 4:
                return data[:a]
            case 5:
                other = rng.choice(self.examples)
                return data[:a] + other[rng.randrange(len(other) + 1) :]
            case _:
                return data[:a] + rng.choice(PIECES) + data[a:]

    def _token(self, data: bytes, rng: random.Random) -> bytes:
        if rng.random() < 0.2:
            return self._lines(data, rng)
        tokens = list(TOKEN.finditer(data))
        if not tokens:
            return data + rng.choice(WORDS).encode()
        chosen = rng.choice(tokens)
        old = chosen.group()
        if old[:1] in b'[]{}=,:;#"' and rng.random() < 0.5:
            new = rng.choice((b"", old * 2, rng.choice(tokens).group(), b'"' + rng.choice(WORDS).encode() + b'"'))
        elif re.match(rb"[+-]?[0-9]", old) or rng.random() < 0.35:
            new = (
                rng.choice(NUMBERS.split()).encode()
                if rng.random() < 0.8
                else rng.choice((b"[1.0, 2.0]", b"{}", b'"x"', b"[]", b"[[1, 0]]"))
            )
        elif rng.random() < 0.2:
            new = rng.choice(tokens).group()
        else:
            new = rng.choice(WORDS).encode()
            if old.startswith(b'"'):
                new = b'"' + new + b'"'
        return data[: chosen.start()] + new + data[chosen.end() :]

    def _lines(self, data: bytes, rng: random.Random) -> bytes:
        lines = data.split(b"\n")
        k, j = rng.randrange(len(lines)), rng.randrange(len(lines))
        match rng.randrange(4):
            case 0:
                del lines[k]
            case 1:
                lines.insert(j, lines[k])
            case 2:
                lines[k], lines[j] = lines[j], lines[k]
            case _:
                lines.insert(j, rng.choice(rng.choice(self.examples).split(b"\n")))
        return b"\n".join(lines)
