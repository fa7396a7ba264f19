"""Error models: frozen values that say how one axis of a sensor errs.

Every model is turned, once, at the sensor's own period, into a `Block`, the only form the filter knows::

    x[j+1]   = Phi x[j] + w[j],    w ~ N(0, Q)
    error[j] = C x[j]   + v[j],    v ~ N(0, r)        x[0] ~ N(0, P0)

Models add: ``White(sd=0.5) + GaussMarkov(sd=0.6, tau_s=30)`` is the sum of two independent errors.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from navfilter.foundation.arrays import Array, ArrayLike
from navfilter.foundation.constants import ROOT_HOUR
from navfilter.foundation.display import Value
from navfilter.foundation.frozen import FrozenDescription
from navfilter.timeseries.roots import is_stable
from navfilter.timeseries.stationary import stationary_covariance

#: beta * tau of an order-n Gauss-Markov process whose autocorrelation falls to 1/e at tau (thesis, after eq 2.42,
#: corrected).
CORRELATION_CONSTANTS = {1: 1.0, 2: 2.14619322062, 3: 2.90462997502, 4: 3.51264845273}
#: A pole nearer to the unit circle than this has no stationary variance in floating point.
UNIT_ROOT = 1e-12
#: Time constants in a period, beyond which it is no longer: nothing is left of the process then.
LONGEST = 350.0


@dataclass(frozen=True, eq=False, repr=False)
class Block(Value):
    """One axis of an error model, discretised at the period of its sensor.

    Attributes
    ----------
    Phi, Q, P0 : ndarray, shape (n, n)
        Transition, process noise covariance of one tick, covariance at the start.
    C : ndarray, shape (n,)
        Output row: the error is ``C @ x`` plus white noise of variance `r`.
    r : float
        Variance of the white part of one sample.
    """

    Phi: Array
    Q: Array
    C: Array
    r: float
    P0: Array

    def _shown(self) -> tuple[str, dict[str, object]]:
        rows = {name: getattr(self, name).tolist() if self.size else None for name in ("Phi", "Q", "C", "P0")}
        return f"Block of {self.size} states", {**rows, "r": self.r}

    @property
    def size(self) -> int:
        """Number of states n (0 for white noise)."""
        return len(self.C)

    @property
    def state_variance(self) -> float:
        """Of the error without its white part, at the start."""
        return float(self.C @ self.P0 @ self.C)

    @property
    def variance(self) -> float:
        """Of a single reading at the start."""
        return self.state_variance + self.r


def block_level(block: Block) -> float:
    """S(0) per sample of a stationary block."""
    response = np.linalg.solve(np.eye(block.size) - block.Phi.T, block.C) if block.size else np.zeros(0)
    return float(response @ block.Q @ response) + block.r


def stated_variance(model: "ErrorModel") -> float:
    """Of a single reading where a description begins, at one in a second: what it believes of it beforehand."""
    return model.block(1.0).variance


class Integrated(NamedTuple):
    """What the integral of an error gathers, see `ErrorModel.integrated`.

    Attributes
    ----------
    white : float
        Variance per sample of the white noise that the integral cannot tell from the error [unit^2].
    walk : float
        Variance that its bias gains per sample [unit^2].
    start : float
        Variance of that bias at the start [unit^2].
    """

    white: float
    walk: float = 0.0
    start: float = 0.0


def _as_walk(block: Block) -> Integrated:
    return Integrated(block.r, float(block.C @ block.Q @ block.C), block.state_variance)


class ErrorModel(FrozenDescription):
    """Base of all error models; a model is a frozen value and models add with ``+``."""

    @property
    def terms(self) -> "tuple[ErrorModel, ...]":
        """The errors it is the sum of: itself, if it is no sum."""
        return (self,)

    def block(self, period_s: float) -> Block:
        """Discretise at the sensor's period.

        Parameters
        ----------
        period_s : float
            Sampling period of the sensor [s].

        Returns
        -------
        Block
        """
        raise NotImplementedError

    def in_force(self, period_s: float) -> Block:
        """Discretise as a filter believes the readings: its block, but for what is yet to be learnt.

        Parameters
        ----------
        period_s : float
            Sampling period of the sensor [s].

        Returns
        -------
        Block
        """
        return self.block(period_s)

    def integrated(self, period_s: float) -> Integrated:
        """What this error looks like to an integral of the readings: white noise, and a bias that wanders.

        Default: a stationary error is forgotten within the time of an integral, which then sees white noise of its
        S(0); one with a unit root is a bias that wanders by its own driving noise.

        Parameters
        ----------
        period_s : float
            Sampling period of the sensor [s].

        Returns
        -------
        Integrated
        """
        block = self.block(period_s)
        if block.size and float(np.abs(np.linalg.eigvals(block.Phi)).max()) > 1.0 - UNIT_ROOT:
            return _as_walk(block)
        return Integrated(block_level(block))

    def __add__(self, other: "ErrorModel") -> "Sum":
        if not isinstance(other, ErrorModel):
            return NotImplemented
        return Sum((*self.terms, *other.terms))


#: One for all axes of a sensor, or one for each.
Errors = ErrorModel | tuple[ErrorModel, ...]


def sum_of(parts: Sequence[ErrorModel]) -> ErrorModel:
    """The sum of error models, or the one there is."""
    return Sum(tuple(parts)) if len(parts) > 1 else parts[0]


def check_numbers(of: object, *names: str, zero_ok: bool = True, usual: str = "") -> None:
    """Raises ValueError where a setting of a description is no finite number, or negative, or zero and may not be; None
    is fine where it is the default.
    """
    for name in names:
        value, left_out = getattr(of, name), getattr(type(of), name, math.nan)
        if value is None and left_out is None:
            continue
        if not (value is not None and math.isfinite(value) and (value > 0 or (zero_ok and value == 0))):
            bound, hint = ">= 0" if zero_ok else "> 0", f" Usual: {usual}." if usual else ""
            raise ValueError(f"{type(of).__name__}.{name} must be a finite number {bound}, found {value!r}.{hint}")


def _square(values: ArrayLike, n: int) -> Array:
    return np.ascontiguousarray(np.asarray(values, dtype=np.float64).reshape(n, n))


@dataclass(frozen=True)
class White(ErrorModel):
    """White noise, independent from sample to sample.

    Parameters
    ----------
    sd : float, optional
        Standard deviation of one sample [unit of the sensor].
    density : float, optional
        Root power spectral density [unit/sqrt(Hz)]; the variance of a sample is ``density**2 * rate`` (Groves, 2013,
        sec. 14.2.6). Give either `sd` or `density`.

    Examples
    --------
    >>> White(density=0.01).block(period_s=0.25).r
    0.0004
    """

    sd: float | None = None
    density: float | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if (self.sd is None) == (self.density is None):
            raise ValueError(
                f"White needs exactly one of sd and density, found sd={self.sd!r}, density={self.density!r}."
            )
        check_numbers(self, "sd", "density")

    def block(self, period_s: float) -> Block:
        """Discretise: no state, only a white variance."""
        r = self.sd**2 if self.sd is not None else self.density**2 / period_s  # type: ignore[operator]
        return Block(np.zeros((0, 0)), np.zeros((0, 0)), np.zeros(0), float(r), np.zeros((0, 0)))


@dataclass(frozen=True)
class RandomWalk(ErrorModel):
    """Random walk (Wiener process): a bias that wanders; with ``density=0`` a constant.

    Parameters
    ----------
    density : float
        Root PSD of the rate of change [unit/s/sqrt(Hz)]: the variance grows by ``density**2`` per second (Groves, 2013,
        sec. 14.2.6).
    start_sd : float, optional
        Standard deviation at the start [unit], such as a turn-on bias. Default: what the walk gathers in one hour,
        ``60 * density``.

    Examples
    --------
    >>> float(RandomWalk(density=2.0).block(period_s=0.25).Q[0, 0])
    1.0
    """

    density: float
    start_sd: float | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        check_numbers(self, "density", "start_sd")

    def block(self, period_s: float) -> Block:
        """Discretise: exact for any period."""
        start = ROOT_HOUR * self.density if self.start_sd is None else self.start_sd
        return Block(np.eye(1), _square(self.density**2 * period_s, 1), np.ones(1), 0.0, _square(start**2, 1))


@dataclass(frozen=True)
class GaussMarkov(ErrorModel):
    """Stationary Gauss-Markov process of order 1 to 4: ``(d/dt + beta)^n x = w`` (thesis eq 2.41, corrected; Gelb,
    1974, sec. 3.6).

    Parameters
    ----------
    sd : float
        Stationary standard deviation [unit].
    tau_s : float
        Correlation time [s]: lag at which the autocorrelation is 1/e. ``beta = c_n / tau`` with c = 1, 2.1462, 2.9046,
        3.5126.
    order : int
        1 to 4.

    Notes
    -----
    The states are the process and its derivatives scaled by powers of beta, so that all have comparable size.

    Examples
    --------
    >>> block = GaussMarkov(sd=2.0, tau_s=10.0).block(period_s=10.0)
    >>> round(float(block.Phi[0, 0]), 6), float(block.P0[0, 0])
    (0.367879, 4.0)
    """

    sd: float
    tau_s: float
    order: int = 1

    def __post_init__(self) -> None:
        super().__post_init__()
        check_numbers(self, "sd")
        check_numbers(self, "tau_s", zero_ok=False)
        if self.order not in CORRELATION_CONSTANTS:
            raise ValueError(
                f"GaussMarkov.order must be 1, 2, 3 or 4, found {self.order!r}. For other orders use Arma."
            )

    @property
    def beta(self) -> float:
        """Inverse time constant of the n equal poles [1/s]."""
        return CORRELATION_CONSTANTS[self.order] / self.tau_s

    def block(self, period_s: float) -> Block:
        """Discretise, exactly."""
        Phi, Q, P0 = gauss_markov(self.order, self.sd, self.beta * period_s)
        return Block(Phi, Q, np.eye(self.order)[0], 0.0, P0)

    def integrated(self, period_s: float) -> Integrated:
        """As a walk: such a model states a bias that outlasts the integral, which sees the beginning of a walk from its
        variance.
        """
        return _as_walk(self.block(period_s))


@dataclass(frozen=True)
class Arma(ErrorModel):
    """ARMA(p, q) process that ticks with its sensor: ``A(q) y = C(q) e`` with ``A = 1 + ar[0] q^-1 + ...``.

    Parameters
    ----------
    ar, ma : sequence of float
        Coefficients without the leading one, in the sign convention of ``scipy.signal.lfilter([1, *ma], [1, *ar], e)``.
    sd : float
        Standard deviation of the innovation e [unit].

    Notes
    -----
    State form of Harvey (1989, sec. 3.3): dimension max(p, q+1), no separate measurement noise. The start is stationary
    (discrete Lyapunov equation), so the poles must lie inside the unit circle; a unit root belongs into ``RandomWalk``.

    Examples
    --------
    >>> block = Arma(ar=[-0.8], ma=[], sd=0.6).block(period_s=1.0)
    >>> round(float(block.P0[0, 0]), 9)
    1.0
    """

    ar: tuple[float, ...]
    ma: tuple[float, ...] = ()
    sd: float = field(default=1.0)

    if TYPE_CHECKING:  # what is handed over becomes what the fields are

        def __init__(self, ar: Sequence[float], ma: Sequence[float] = (), sd: float = 1.0) -> None: ...

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("ar", "ma"):
            given = getattr(self, name)
            numbers = isinstance(given, tuple) and all(isinstance(c, float | int) for c in given)
            if not (numbers and all(map(math.isfinite, given))):
                raise ValueError(f"Arma.{name} must be finite numbers in a sequence, as [-0.8], found {given!r}.")
            values = tuple(map(float, given))
            object.__setattr__(self, name, values)
        check_numbers(self, "sd")
        if not is_stable(np.array(self.ar)):
            radius = max(abs(np.roots([1.0, *self.ar])))
            raise ValueError(
                f"Arma.ar has a pole of radius {radius:.6f}: the error would grow without bound. Use a pole inside the "
                "unit circle, or RandomWalk(...) + Arma(...) for a unit root."
            )

    def block(self, period_s: float) -> Block:
        """Discretise: the model is discrete already, `period_s` only says how often it ticks."""
        n = max(len(self.ar), len(self.ma) + 1)
        F = np.diag(np.ones(n - 1), 1)
        F[: len(self.ar), 0] = -np.array(self.ar)
        h = np.zeros(n)
        h[: len(self.ma) + 1] = [1.0, *self.ma]
        Q = self.sd**2 * np.outer(h, h)
        return Block(F, Q, np.eye(n)[0], 0.0, stationary_covariance(F, Q))


@dataclass(frozen=True)
class Sum(ErrorModel):
    """Sum of independent errors; made by ``a + b``."""

    parts: tuple[ErrorModel, ...]

    @property
    def terms(self) -> tuple[ErrorModel, ...]:
        """Its parts."""
        return self.parts

    def block(self, period_s: float) -> Block:
        """Discretise: the blocks of the parts side by side."""
        return joined_block([part.block(period_s) for part in self.parts])

    def in_force(self, period_s: float) -> Block:
        """That of the parts side by side."""
        return joined_block([part.in_force(period_s) for part in self.parts])

    def integrated(self, period_s: float) -> Integrated:
        """Part by part: the errors are independent, so that the variances add."""
        each = [part.integrated(period_s) for part in self.parts]
        return Integrated(sum(e.white for e in each), sum(e.walk for e in each), sum(e.start for e in each))

    def __repr__(self) -> str:
        return " + ".join(map(repr, self.parts))

    def __str__(self) -> str:
        return " + ".join(map(str, self.parts))


def block_diagonal(matrices: Sequence[Array]) -> Array:
    """Square matrices along the diagonal of one (that of scipy takes a millisecond for a handful of small ones)."""
    n = sum(len(matrix) for matrix in matrices)
    out, at = np.zeros((n, n)), 0
    for matrix in matrices:
        out[at : at + len(matrix), at : at + len(matrix)] = matrix
        at += len(matrix)
    return out


def joined_block(blocks: Sequence[Block]) -> Block:
    """Blocks of independent errors side by side, as one that stands for their sum."""
    n = sum(b.size for b in blocks)
    stack = {
        key: _square(block_diagonal([getattr(b, key) for b in blocks]), n) if n else np.zeros((0, 0))
        for key in ("Phi", "Q", "P0")
    }
    C = np.concatenate([np.zeros(0), *(b.C for b in blocks)])
    return Block(stack["Phi"], stack["Q"], C, sum(b.r for b in blocks), stack["P0"])


def _found(error: object) -> str:
    if isinstance(error, type):
        return f"the class {error.__name__}, which wants its numbers in brackets"
    return f"{len(error)} of them" if isinstance(error, tuple) and len(error) > 3 else repr(error)


def per_axis(error: ErrorModel | Sequence[ErrorModel], axes: int, owner: str) -> tuple[ErrorModel, ...]:
    """One model per axis: a single model serves all axes, a sequence gives one each.

    Raises
    ------
    ValueError
        When something is not an error model or the number does not fit.
    """
    models = (error,) * axes if isinstance(error, ErrorModel) else tuple(error) if isinstance(error, Sequence) else ()
    if len(models) != axes or not all(isinstance(m, ErrorModel) for m in models):
        raise ValueError(
            f"{owner} needs one error model, or a tuple of {axes}, found {_found(error)}. Example: "
            "White(sd=0.1) + RandomWalk(density=1e-4)."
        )
    return models


# --- what swings -----------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Cycle(ErrorModel):
    """Stationary swing of known period, whose amplitude and phase wander (Harvey, 1989, sec. 2.3.4: stochastic cycle).

    Parameters
    ----------
    sd : float
        Stationary standard deviation [unit]; a steady swing of amplitude a has ``a / sqrt(2)``.
    period_s : float
        Of the swing [s]; a semidiurnal tide 44714, a diurnal one 89428.
    tau_s : float
        Time in which amplitude and phase become others [s].

    Notes
    -----
    Autocovariance ``sd^2 exp(-t / tau) cos(2 pi t / period)``. Two states: the swing, and what it is a quarter of a
    period later; both turn into each other.

    Examples
    --------
    >>> block = Cycle(sd=0.2, period_s=40.0, tau_s=1e6).block(period_s=10.0)
    >>> [round(float(x), 3) for x in block.Phi[0]]
    [0.0, 1.0]
    """

    sd: float
    period_s: float
    tau_s: float

    def __post_init__(self) -> None:
        super().__post_init__()
        check_numbers(self, "sd")
        check_numbers(self, "period_s", "tau_s", zero_ok=False)

    def block(self, period_s: float) -> Block:
        """Discretise: exact for any period."""
        angle, keep = 2.0 * math.pi * period_s / self.period_s, math.exp(-period_s / self.tau_s)
        turn = np.array([[math.cos(angle), math.sin(angle)], [-math.sin(angle), math.cos(angle)]])
        gained = -math.expm1(-2.0 * period_s / self.tau_s) * self.sd**2
        return Block(keep * turn, gained * np.eye(2), np.array([1.0, 0.0]), 0.0, self.sd**2 * np.eye(2))


# --- from continuous to discrete -------------------------------------------------------------------------------------


@lru_cache(maxsize=256)
def gauss_markov(n: int, sd: float, step: float) -> tuple[Array, Array, Array]:
    """Transition, noise of one period and stationary covariance of a process of order n; its state has the error and
    its derivatives in time constants.

    Asked for at each change of the layout, and by learners under way, who find orders 1 and 2: these are in closed
    form, for no import may hold up the navigation. Above it is Van Loan's method (IEEE Trans. AC 23, 1978).

    Parameters
    ----------
    n : int
    sd : float
    step : float
        Period, in time constants of the poles.
    """
    step = min(step, LONGEST)
    P0 = _stationary(n) * sd**2
    if n == 1:
        return np.array([[math.exp(-step)]]), np.array([[-math.expm1(-2.0 * step) * sd**2]]), P0
    if n == 2:
        return *_second_order(sd**2, step), P0
    if step > 2.0:
        # Van Loan's matrix holds exp(+step), which swallows all digits of Q when much decays between two samples;
        # what has decayed is what the stationary variance makes up for. F has the one eigenvalue -1, so that the
        # series of exp((F + 1) step) ends.
        N = _dynamics(n) + np.eye(n)
        terms = [np.linalg.matrix_power(N, k) * (step**k / math.factorial(k)) for k in range(n)]
        Phi = math.exp(-step) * np.sum(terms, axis=0)
        Q = P0 - Phi @ P0 @ Phi.T
    else:
        from filterpy.common import van_loan_discretization  # costs half a second to import

        # White noise of this spectral density drives the last state; the process then has this variance (thesis
        # eq 2.42, corrected).
        density = sd**2 * 2.0 ** (2 * n - 1) * math.factorial(n - 1) ** 2 / math.factorial(2 * n - 2)
        Phi, Q = van_loan_discretization(_dynamics(n), math.sqrt(density) * np.eye(n)[:, -1:], step)
    return np.ascontiguousarray(Phi), np.ascontiguousarray((Q + Q.T) / 2), P0


def _dynamics(n: int) -> Array:
    F = np.diag(np.ones(n - 1), 1)
    F[-1] = [-math.comb(n, k) for k in range(n)]
    return F


def _second_order(variance: float, step: float) -> tuple[Array, Array]:
    """Elements of Q are integrals of ``g_i g_j``, ``g = [u exp(-u), (1 - u) exp(-u)]``, from 0 to `step`, times the
    spectral density ``4 variance``.
    """
    decay, twice = math.exp(-step), 2.0 * step
    # what exp(2 step) is above the beginning of its series: by its terms where the difference would cancel
    if twice < 2.0:
        above = sum(twice**k / math.factorial(k) for k in range(3, 24))
    else:
        above = math.exp(twice) - 1.0 - twice - twice**2 / 2.0
    value, cross = above * decay**2, 2.0 * (step * decay) ** 2
    Q = variance * np.array([[value, cross], [cross, value + 4.0 * step * decay**2]])
    return decay * np.array([[1.0 + step, step], [-step, 1.0 - step]]), Q


def _stationary(n: int) -> Array:
    """Stationary covariance of the scaled states for unit variance: E[x^(i) x^(j)] = (-1)^j R^(i+j)(0), odd derivatives
    vanish.
    """
    # Partial moments of the spectrum 1/(1 + w^2)^n: m_2k = integral of w^2k S(w), ratio by the beta function.
    moment = [math.gamma(k + 0.5) * math.gamma(n - k - 0.5) / (math.gamma(0.5) * math.gamma(n - 0.5)) for k in range(n)]
    P = np.zeros((n, n))
    for i in range(n):
        for j in range(n):
            if (i + j) % 2 == 0:
                P[i, j] = (-1.0) ** ((j - i) // 2) * moment[(i + j) // 2]
    return P
