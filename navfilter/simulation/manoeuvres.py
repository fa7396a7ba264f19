"""Manoeuvres a simulated vehicle is driven through: the segments a `navfilter.simulation.motion.Motion` is built from.

Every manoeuvre is a frozen value that unfolds into `Piece`s. Within a piece the speed, the turn rate, the pitch and the
roll each go from where they are to their new value along the same seventh-order blend, whose first three derivatives
vanish at both ends; so acceleration and angular acceleration are continuous across the joints. Every manoeuvre begins
and ends straight and level: any order of them is a valid motion.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy.optimize import brentq

# 35 u^4 - 84 u^5 + 70 u^6 - 20 u^7, highest power first: the least polynomial from 0 to 1 with three flat derivatives
BLEND = (-20.0, 70.0, -84.0, 35.0, 0.0, 0.0, 0.0, 0.0)
_GAUSS_X, _GAUSS_W = np.polynomial.legendre.leggauss(16)
_UNIT_X, _UNIT_W = 0.5 * (_GAUSS_X + 1.0), 0.5 * _GAUSS_W
_BLENDED = np.polyval(BLEND, _UNIT_X)


@dataclass(frozen=True)
class Piece:
    """One stretch of motion: the values reached at its end.

    Attributes
    ----------
    duration_s : float
        Time from the end of the piece before, s (positive).
    speed_m_s : float
        Speed along the forward axis, m/s.
    turn_rate, pitch, roll : float
        Rate of heading (rad/s), pitch and roll (rad).
    """

    duration_s: float
    speed_m_s: float
    turn_rate: float = 0.0
    pitch: float = 0.0
    roll: float = 0.0


class Manoeuvre(Protocol):
    """What `Motion` asks of a segment."""

    def pieces(self, speed_m_s: float, depth_m: float) -> Iterator[Piece]:
        """Pieces of the manoeuvre for a vehicle that arrives level, straight, at this speed and depth."""


def descent(before: Piece, piece: Piece) -> float:
    """Depth gained within one piece, m: the integral of speed times the sine of the downward pitch."""
    speed = before.speed_m_s + (piece.speed_m_s - before.speed_m_s) * _BLENDED
    pitch = before.pitch + (piece.pitch - before.pitch) * _BLENDED
    return -piece.duration_s * float(_UNIT_W @ (speed * np.sin(pitch)))


@dataclass(frozen=True)
class ChangeSpeed:
    """Go from the present speed to another one, straight and level.

    Parameters
    ----------
    to_m_s : float
        Speed reached, m/s; 0 stops the vehicle.
    duration_s : float
        Time it takes, s.
    """

    to_m_s: float
    duration_s: float = 10.0

    def __post_init__(self) -> None:
        _positive("duration_s", self.duration_s)

    def pieces(self, speed_m_s: float, depth_m: float) -> Iterator[Piece]:
        yield Piece(self.duration_s, self.to_m_s)


@dataclass(frozen=True)
class Wait:
    """Stay where one is, at rest: at the surface for fixes, or on the ground.

    Parameters
    ----------
    duration_s : float
        Time at rest, s.
    """

    duration_s: float

    def __post_init__(self) -> None:
        _positive("duration_s", self.duration_s)

    def pieces(self, speed_m_s: float, depth_m: float) -> Iterator[Piece]:
        if speed_m_s != 0.0:
            raise ValueError(
                f"Wait needs a vehicle at rest, but it moves at {speed_m_s} m/s. Put ChangeSpeed(0) first."
            )
        yield Piece(self.duration_s, 0.0)


@dataclass(frozen=True)
class Straight:
    """Straight and level transit, by its duration or its distance.

    Parameters
    ----------
    duration_s : float, optional
        Time under way, s.
    distance_m : float, optional
        Way made good, m; give one of the two.
    """

    duration_s: float | None = None
    distance_m: float | None = None

    def __post_init__(self) -> None:
        if (self.duration_s is None) == (self.distance_m is None):
            raise ValueError("Straight needs either duration_s or distance_m, not both and not neither.")
        _positive("duration_s or distance_m", self.duration_s if self.distance_m is None else self.distance_m)

    def pieces(self, speed_m_s: float, depth_m: float) -> Iterator[Piece]:
        if self.duration_s is not None:
            yield Piece(self.duration_s, speed_m_s)
        elif self.distance_m is not None:
            yield Piece(self.distance_m / _moving("Straight", speed_m_s), speed_m_s)


@dataclass(frozen=True)
class Turn:
    """Turn to the right (positive) or left at constant rate, banking into it.

    Parameters
    ----------
    angle_deg : float
        Change of heading, deg; may exceed a full circle.
    rate_deg_s : float
        Rate in the steady part, deg/s (positive).
    bank_deg : float
        Roll in the steady part, deg, towards the inside of the turn.
    blend_s : float
        Time to enter, and to leave, the steady part, s.
    """

    angle_deg: float
    rate_deg_s: float = 6.0
    bank_deg: float = 4.0
    blend_s: float = 4.0

    def __post_init__(self) -> None:
        _positive("rate_deg_s", self.rate_deg_s)
        _positive("blend_s", self.blend_s)

    def pieces(self, speed_m_s: float, depth_m: float) -> Iterator[Piece]:
        angle = math.radians(abs(self.angle_deg))
        rate = math.radians(self.rate_deg_s)
        # the two blends together turn by rate * blend_s: a short turn never reaches the rate that was asked for
        reached = min(rate, angle / self.blend_s)
        side = math.copysign(1.0, self.angle_deg)
        turn, roll = side * reached, side * math.radians(self.bank_deg) * reached / rate
        yield Piece(self.blend_s, speed_m_s, turn, 0.0, roll)
        steady = angle / reached - self.blend_s if angle > 0.0 else 0.0
        if steady > 1e-9:
            yield Piece(steady, speed_m_s, turn, 0.0, roll)
        yield Piece(self.blend_s, speed_m_s)


@dataclass(frozen=True)
class Dive:
    """Dive (or climb) to a depth, straight on, or turning all the way: the spiral dive.

    Parameters
    ----------
    to_depth_m : float
        Depth reached, m below the surface (0 = surface).
    pitch_deg : float
        Steepest pitch, deg (positive number; nose down when diving, up when climbing).
    rate_deg_s : float
        Turn rate of a spiral, deg/s, right positive; 0 dives straight on.
    bank_deg : float
        Roll of a spiral, deg, towards the inside.
    blend_s : float
        Time to pitch down, and to level out, s.
    """

    to_depth_m: float
    pitch_deg: float = 15.0
    rate_deg_s: float = 0.0
    bank_deg: float = 4.0
    blend_s: float = 6.0

    def __post_init__(self) -> None:
        _positive("blend_s", self.blend_s)
        if not 0.0 < self.pitch_deg < 80.0:
            raise ValueError(f"pitch_deg must lie between 0 and 80, found {self.pitch_deg}.")

    def pieces(self, speed_m_s: float, depth_m: float) -> Iterator[Piece]:
        change = self.to_depth_m - depth_m
        if abs(change) < 1e-6:
            return
        speed = _moving("Dive", speed_m_s)
        down = math.copysign(1.0, change)
        steepest = math.radians(self.pitch_deg)
        reach = abs(change) - self._blends(speed, steepest)
        if reach < 0.0:
            steepest = brentq(lambda p: self._blends(speed, p) - abs(change), 0.0, steepest, xtol=1e-14)
            reach = 0.0
        turn = math.radians(self.rate_deg_s)
        roll = math.copysign(math.radians(self.bank_deg), turn) if turn else 0.0
        steep = Piece(self.blend_s, speed, turn, -down * steepest, roll)
        yield steep
        steady = reach / (speed * math.sin(steepest))
        if steady > 1e-9:
            yield Piece(steady, speed, turn, -down * steepest, roll)
        yield Piece(self.blend_s, speed)

    def _blends(self, speed: float, pitch: float) -> float:
        return 2.0 * abs(descent(Piece(1.0, speed), Piece(self.blend_s, speed, pitch=pitch)))


def SpiralDive(to_depth_m: float, pitch_deg: float = 8.0, rate_deg_s: float = 4.0, bank_deg: float = 4.0) -> Dive:
    """Dive while turning steadily (see `Dive`)."""
    return Dive(to_depth_m, pitch_deg, rate_deg_s, bank_deg)


def Surface(pitch_deg: float = 15.0) -> Dive:
    """Climb straight on to the surface (see `Dive`)."""
    return Dive(0.0, pitch_deg)


@dataclass(frozen=True)
class Lawnmower:
    """Survey pattern: parallel legs joined by pairs of right-angled turns, alternately right and left.

    Parameters
    ----------
    legs : int
        Number of legs.
    leg_m : float
        Length of a leg, m.
    spacing_m : float
        Distance between legs along the connecting stretch, m (the turns come on top).
    rate_deg_s, bank_deg, blend_s : float
        Of the turns, see `Turn`.
    """

    legs: int
    leg_m: float
    spacing_m: float = 20.0
    rate_deg_s: float = 6.0
    bank_deg: float = 4.0
    blend_s: float = 4.0

    def __post_init__(self) -> None:
        _positive("legs", self.legs)
        _positive("leg_m", self.leg_m)
        _positive("spacing_m", self.spacing_m)

    def pieces(self, speed_m_s: float, depth_m: float) -> Iterator[Piece]:
        for leg in range(self.legs):
            yield from Straight(distance_m=self.leg_m).pieces(speed_m_s, depth_m)
            if leg + 1 == self.legs:
                return
            angle = 90.0 if leg % 2 == 0 else -90.0
            turn = Turn(angle, self.rate_deg_s, self.bank_deg, self.blend_s)
            yield from turn.pieces(speed_m_s, depth_m)
            yield from Straight(distance_m=self.spacing_m).pieces(speed_m_s, depth_m)
            yield from turn.pieces(speed_m_s, depth_m)


@dataclass(frozen=True)
class FigureEight:
    """Full circles, alternately right and left; each moves on by about the way of one blend.

    Parameters
    ----------
    rounds : int
        Number of complete eights.
    rate_deg_s, bank_deg, blend_s : float
        Of the circles, see `Turn`.
    """

    rounds: int = 1
    rate_deg_s: float = 4.0
    bank_deg: float = 4.0
    blend_s: float = 4.0

    def __post_init__(self) -> None:
        _positive("rounds", self.rounds)

    def pieces(self, speed_m_s: float, depth_m: float) -> Iterator[Piece]:
        for _ in range(self.rounds):
            for angle in (360.0, -360.0):
                yield from Turn(angle, self.rate_deg_s, self.bank_deg, self.blend_s).pieces(speed_m_s, depth_m)


def _positive(name: str, value: float | None) -> None:
    if value is None or not value > 0.0:
        raise ValueError(f"{name} must be positive, found {value}.")


def _moving(name: str, speed_m_s: float) -> float:
    if not speed_m_s > 0.0:
        raise ValueError(f"{name} needs a vehicle that moves, but its speed is {speed_m_s} m/s. Put ChangeSpeed first.")
    return speed_m_s
