"""Rivals by name: the same vehicle with error models of one kind, fitted to the mission it is about to run.

To be fair to the older models, those that are fitted here see the whole mission beforehand, while ``arma`` learns under
way from what it has seen so far. None of them sees the truth but ``oracle``, whose very point that is.

Adaptive rivals: filters of the literature that estimate the noise R of a sensor from its innovations.

They are baselines to compare with, and no part of the filter: the same mechanisation, calibration states and gate, but
each error is white noise, whose variance a rule sets. There are two kinds of rules: a `Rule` knows the readings before,
a `ReadingRule` the innovation of the very reading that it weighs, too. A rule of one's own has the two methods of
either, and goes to `adaptive_monitor`.
"""

import math
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from typing import Any, Protocol, runtime_checkable

import numpy as np

from navfilter.faults.innovation_gate import whole_residual
from navfilter.faults.monitor import FaultMonitor
from navfilter.filter.actions import Action, Readmit
from navfilter.filter.monitor import Actions, FilterState
from navfilter.filter.sensor_channel import Channel
from navfilter.filter.state_layout import Layout
from navfilter.foundation.arrays import Array, ArrayLike
from navfilter.learning.open_loop_series import ChannelSeries
from navfilter.models.error_models import ErrorModel, Errors, GaussMarkov, RandomWalk, Sum, White, sum_of
from navfilter.models.learned_arma import LearnedArma, known_white, learned_part
from navfilter.models.mission import Mission
from navfilter.models.start import Start
from navfilter.models.vehicle import Vehicle
from navfilter.models.window_limits import LEAST
from navfilter.playback.replay import replay, replay_monitored, residual_series
from navfilter.timeseries.fit import fit_gauss_markov
from navfilter.track.track import Track

#: R stays within these multiples of the R that is described [1].
FLOOR, CEILING = 0.1, 100.0


class Rule(Protocol):
    """What the white variance of a sensor's axes is, given their innovations so far."""

    def variance(self) -> Array:
        """For the next reading, shape (axes,)."""

    def update(self, innovation: Array, predicted: Array) -> None:
        """Take a reading that was used.

        Parameters
        ----------
        innovation : ndarray, shape (axes,)
            NaN where a component is missing.
        predicted : ndarray, shape (axes,)
            Its variance but for R: the diagonal of ``H P H'`` before the correction.
        """


@runtime_checkable
class ReadingRule(Protocol):
    """What the white variance of a reading is, given its own innovation, too.

    The gate judges by what is expected beforehand, `variance`; a reading that passes it is weighed, and used by that.
    Of sensors of which single components may be left out, such as beams, the whole reading is judged.
    """

    def variance(self) -> Array:
        """Expected for the next reading, shape (axes,)."""

    def weigh(self, innovation: Array, predicted: Array) -> Array:
        """Take a reading that is about to be used, and return its variance, shape (axes,).

        Parameters
        ----------
        innovation : ndarray, shape (axes,)
            NaN where a component is missing.
        predicted : ndarray, shape (axes, axes)
            Its covariance but for R: ``H P H'`` before the correction.
        """


class InnovationAdaptive:
    """``R = mean(innovation^2 - H P H')`` over a window (Mehra, 1970; Mohamed and Schwarz, 1999).

    Parameters
    ----------
    described : ndarray, shape (axes,)
    readings : int
        Of the window; until it is full the described R holds.
    """

    def __init__(self, described: Array, readings: int = 30) -> None:
        self._described, self._readings = described, readings
        self._window: list[Array] = []

    def variance(self) -> Array:
        """See `Rule`."""
        if len(self._window) < self._readings:
            return self._described
        window = np.array(self._window)
        known = np.isfinite(window).sum(axis=0)
        mean = np.nansum(window, axis=0) / np.maximum(known, 1)
        return _bounded(np.where(known > 0, mean, self._described), self._described)

    def update(self, innovation: Array, predicted: Array) -> None:
        """See `Rule`."""
        self._window = [*self._window[1 - self._readings :], innovation**2 - predicted]


class SageHusa:
    """``R <- (1 - d) R + d (innovation^2 - H P H')``, ``d = (1 - b) / (1 - b^k)`` (Sage and Husa, 1969).

    Parameters
    ----------
    described : ndarray, shape (axes,)
    b : float
        Forgetting [1].
    """

    def __init__(self, described: Array, b: float = 0.97) -> None:
        self._described, self._b, self._k = described, b, 0
        self._R = described.copy()

    def variance(self) -> Array:
        """See `Rule`."""
        return _bounded(self._R, self._described)

    def update(self, innovation: Array, predicted: Array) -> None:
        """See `Rule`."""
        self._k += 1
        # the described R counts as one reading, or the first innovation alone would set it
        d = (1.0 - self._b) / (1.0 - self._b ** (self._k + 1))
        new = (1.0 - d) * self.variance() + d * (innovation**2 - predicted)
        self._R = np.where(np.isfinite(new), new, self._R)


class VariationalBayes:
    """Inverse gamma density of R, forgotten by rho (Sarkka and Nummenmaa, 2009); R and state are iterated together.

    Parameters
    ----------
    described : ndarray, shape (axes,)
    rho : float
        Forgetting [1].
    iterations : int
        Of a reading.
    """

    def __init__(self, described: Array, rho: float = 0.97, iterations: int = 5) -> None:
        self._described, self._rho, self._iterations = described, rho, iterations
        self._alpha = np.full(described.shape, 1.0)
        self._beta = described.copy()

    def variance(self) -> Array:
        """See `ReadingRule`."""
        return _bounded(self._beta / self._alpha, self._described)

    def weigh(self, innovation: Array, predicted: Array) -> Array:
        """See `ReadingRule`."""
        known, R = np.isfinite(innovation), self.variance()
        alpha, prior = self._rho * self._alpha + 0.5, self._rho * self._beta
        beta = prior.copy()
        for _ in range(self._iterations):
            R = np.where(known, _bounded(beta / alpha, self._described), R)
            left, spread = _after(innovation, predicted, R)
            beta = prior + 0.5 * (left**2 + spread.diagonal())
        self._alpha, self._beta = np.where(known, alpha, self._alpha), np.where(known, beta, self._beta)
        return R


class StudentT:
    """Student's t in place of a normal error: a reading counts by ``R / w``, iterated with the state (Huang et al.,
    2017).

    Of a reading with m components ``w = (nu + m) / (nu + tr(R^-1 (e e' + H P H')))``, ``e`` and ``P`` being what is
    left after it was used with the w before. Nothing is remembered from reading to reading. A limit: the error of the
    state's own prediction stays normal.

    Parameters
    ----------
    described : ndarray, shape (axes,)
    freedom : float
        Degrees of freedom nu [1].
    iterations : int
        Of a reading.
    """

    def __init__(self, described: Array, freedom: float = 4.0, iterations: int = 5) -> None:
        self._described, self._freedom, self._iterations = described, freedom, iterations

    def variance(self) -> Array:
        """See `ReadingRule`."""
        return self._described

    def weigh(self, innovation: Array, predicted: Array) -> Array:
        """See `ReadingRule`."""
        R = described = self._described
        known = np.isfinite(innovation) & (described > 0.0)
        for _ in range(self._iterations):
            left, spread = _after(innovation, predicted, R)
            distance = ((left**2 + spread.diagonal())[known] / described[known]).sum()
            R = _bounded(described * (self._freedom + distance) / (self._freedom + known.sum()), described)
        return R


class Imm:
    """Three levels of R in a Markov chain (Blom and Bar-Shalom, 1988), merged into one R by their probabilities.

    A limit of what a rule can do: there is one filter, so that the levels have no states of their own to be mixed, and
    the spread between them is missing in its covariance.

    Parameters
    ----------
    described : ndarray, shape (axes,)
    levels : tuple of float
        Multiples of the described R [1].
    stay : float
        Probability of staying at a level from reading to reading [1].
    """

    def __init__(self, described: Array, levels: tuple[float, ...] = (1 / 9, 1.0, 9.0), stay: float = 0.98) -> None:
        self._levels, self._described = np.array(levels)[:, None] * described, described
        n = len(levels)
        self._chain = np.full((n, n), (1.0 - stay) / (n - 1)) + (stay - (1.0 - stay) / (n - 1)) * np.eye(n)
        self._odds = np.full((n, len(described)), 1.0 / n)

    def variance(self) -> Array:
        """See `Rule`."""
        return _bounded(np.sum(self._chain @ self._odds * self._levels, axis=0), self._described)

    def update(self, innovation: Array, predicted: Array) -> None:
        """See `Rule`."""
        S = predicted + self._levels
        weights = self._chain @ self._odds * np.exp(-0.5 * innovation**2 / S) / np.sqrt(S)
        total = weights.sum(axis=0)
        known = np.isfinite(total) & (total > 0.0)
        self._odds = np.where(known, weights / np.where(known, total, 1.0), self._odds)


AnyRule = Rule | ReadingRule
#: Adaptive rivals by name.
RULES: dict[str, Callable[[Array], AnyRule]] = {
    "iae": InnovationAdaptive,
    "sage-husa": SageHusa,
    "vb": VariationalBayes,
    "imm": Imm,
    "student-t": StudentT,
}


def adaptive_monitor(
    vehicle: Vehicle, rule: Callable[[Array], AnyRule], sensors: Collection[str] | None = None, *, gated: bool = True
) -> FaultMonitor:
    """The monitor of a run whose sensors weigh their readings by a rule.

    Parameters
    ----------
    vehicle : Vehicle
        With white errors, see `as_white`.
    rule : callable
        Makes the rule of a sensor, a `Rule` or a `ReadingRule`, from the white variances of its axes as described,
        shape (axes,).
    sensors : collection of str, optional
        Which ones adapt; default all.
    gated : bool
        False: these use every reading, as most papers have it.
    """
    return _AdaptiveMonitor(vehicle, rule, tuple(vehicle.sensors if sensors is None else sensors), gated)


class _AdaptiveMonitor(FaultMonitor):
    in_batches = False

    def __init__(
        self, vehicle: Vehicle, rule: Callable[[Array], AnyRule], sensors: Collection[str], gated: bool
    ) -> None:
        super().__init__(vehicle)
        self._rule, self._sensors, self._gated, self._rules = rule, sensors, gated, dict[str, AnyRule]()
        self._limits, self._variance = np.empty(0), np.empty(0)  # of the reading that is being judged

    def room(self, layout: Layout, channels: Mapping[str, Channel]) -> tuple[int, int]:
        """No bank of faults for what uses every reading as it is described."""
        return super().room(layout, channels) if self._gated else (0, 0)

    def initial_bank(
        self, layout: Layout, channels: Mapping[str, Channel], time_s: float, before: Array | None = None
    ) -> Array:
        """Empty without one."""
        return super().initial_bank(layout, channels, time_s, before) if self._gated else np.zeros(0)

    def gate(self, channel: Channel, z: Array, sd: ArrayLike | None, time_s: float) -> tuple[Array, Array]:
        limits, own = super().gate(channel, z, sd, time_s)
        if channel.name not in self._sensors:
            return limits, own
        if channel.name not in self._rules:
            self._rules[channel.name] = self._rule(np.array(channel.group.r))
        rule = self._rules[channel.name]
        if not self._gated:
            limits = limits.copy()
            limits[1 : channel.axes + 1] = math.inf
        self._limits, self._variance = limits, rule.variance()
        if isinstance(rule, ReadingRule):  # its innovation is asked for first: see `_weigh`
            limits = limits.copy()
            limits[0], limits[1 : channel.axes + 1] = math.inf, -1.0
        return limits, self._variance

    def after_gate(self, filter: FilterState, channel: Channel, time_s: float, frozen: bool) -> Actions:
        rule, a = self._rules.get(channel.name), channel.axes
        if isinstance(rule, ReadingRule):
            yield from self._weigh(rule, filter, channel)
        used, innovation, S = channel.verdict[2], channel.note[3 : 3 + a].copy(), channel.note[3 + a :][:a].copy()
        result: Any = yield from super().after_gate(filter, channel, time_s, frozen)
        if used and rule is not None and not isinstance(rule, ReadingRule):
            rule.update(np.where(np.isfinite(S), innovation, np.nan), S - self._variance)
        return result

    def _weigh(self, rule: ReadingRule, filter: FilterState, channel: Channel) -> Iterator[Action]:
        """Use a reading that its gate has only held back, if it passes, by the variance that its rule gives it."""
        memory, (nis, dof, _) = filter.memory, channel.verdict.tolist()
        if not (dof and nis <= self._limits[int(dof)]) or channel.beyond_belief(memory.x):
            return
        white = np.diag(self._variance)
        predicted = channel.H @ memory.P @ channel.H.T + channel.R - white
        variance = rule.weigh(channel.note[3 : 3 + channel.axes].copy(), predicted)
        channel.R += np.diag(variance) - white
        yield Readmit(channel, whole_residual(channel, memory.x))


def as_white(model: ErrorModel, period_s: float) -> ErrorModel:
    """White noise of the same variance; a random walk, which is the bias of a sensor, stays.

    Parameters
    ----------
    model : ErrorModel
        Of one axis.
    period_s : float
        Of its sensor [s].
    """
    walks = [part for part in model.terms if isinstance(part, RandomWalk)]
    blocks = [part.block(period_s) for part in model.terms if not isinstance(part, RandomWalk)]
    variance = sum(block.variance for block in blocks)
    if variance <= 0.0:
        return model
    white = White(sd=math.sqrt(variance))
    return Sum((*walks, white)) if walks else white


def _bounded(R: Array, described: Array) -> Array:
    return np.asarray(np.clip(R, FLOOR * described, CEILING * described))


def _after(innovation: Array, predicted: Array, R: Array) -> tuple[Array, Array]:
    """What is left of an innovation once it was used with this R, and of ``H P H'``; a missing one changes nothing."""
    known = np.isfinite(innovation)
    S = np.where(np.outer(known, known), predicted + np.diag(R), np.eye(len(R)))
    seen = np.where(known, predicted, 0.0)
    gain = np.linalg.solve(S, seen.T).T
    return np.where(known, innovation, 0.0) - gain @ np.where(known, innovation, 0.0), predicted - gain @ seen.T


__all__ = ["LEAST"]

Series = Mapping[str, tuple[ChannelSeries, ...]]

#: Kinds of error models that can be compared.
MODELS = ("white", "gm1", "gm1-fitted", "arma", "oracle", "vehicle", *RULES)


def rival(
    name: str,
    vehicle: Vehicle,
    mission: Mission,
    *,
    sensors: Sequence[str] | None = None,
    truth: Mapping[str, Errors] | None = None,
    start: Start | None = None,
) -> Vehicle:
    """The vehicle with error models of one kind on its correcting sensors.

    Parameters
    ----------
    name : str
        One of `MODELS`.
        white: white noise, its sd by the likelihood of the channel (the slow navigation error estimated beside it).
        gm1: first-order Gauss-Markov through the 1/e point of the autocorrelation of the detrended series (thesis, sec.
        2.3). gm1-fitted: first-order Gauss-Markov by that likelihood. arma: `LearnedArma`, which learns under way and
        begins with the model of the vehicle file. oracle: `truth`. vehicle: as the file says. iae, sage-husa, vb, imm,
        student-t: white noise of the variance that the file describes; `replay_rival` adapts it
        (`navfilter.evaluation.baselines`).
    vehicle : Vehicle
        As its operator describes it.
    mission : Mission
    sensors : sequence of str, optional
        Which ones; default all of `learnable`.
    truth : dict of str to ErrorModel or tuple of ErrorModel, optional
        The simulator's models by sensor; only for "oracle". A sensor that is not in it keeps its model.
    start : Start, optional
        As for `navfilter.replay`.

    Returns
    -------
    Vehicle

    Raises
    ------
    ValueError
        For an unknown name or sensor, and for "oracle" without a truth.
    """
    return rivals((name,), vehicle, mission, sensors=sensors, truth=truth, start=start)[name]


def replay_rival(
    name: str, vehicle: Vehicle, mission: Mission, sensors: Sequence[str] | None = None, **how: Any
) -> Track:
    """Replay a rival, see `rival`; those that adapt their noise do so.

    Parameters
    ----------
    name : str
    vehicle : Vehicle
        As `rival` gave it.
    mission : Mission
    sensors : sequence of str, optional
        Which ones adapt; default all.
    **how
        Of `navfilter.replay`.
    """
    if name not in RULES:
        return replay(vehicle, mission, **how)
    return replay_monitored(vehicle, mission, adaptive_monitor(vehicle, RULES[name], sensors), **how)


def rivals(
    names: Sequence[str],
    vehicle: Vehicle,
    mission: Mission,
    *,
    sensors: Sequence[str] | None = None,
    truth: Mapping[str, Errors] | None = None,
    start: Start | None = None,
    series: Series | None = None,
) -> dict[str, Vehicle]:
    """Several rivals at once, see `rival`; the series that they are fitted to are made only once, or not at all where
    they are given (see `navfilter.playback.replay.replay_heard`).
    """
    unknown = [name for name in names if name not in MODELS]
    if unknown:
        raise ValueError(f'there is no model "{unknown[0]}". Models: {", ".join(MODELS)}.')
    sensors = [sensors] if isinstance(sensors, str) else sensors
    chosen = learnable(vehicle, mission) if sensors is None else tuple(sensors)
    _check_sensors(vehicle, chosen)
    if "oracle" in names and not truth:
        raise ValueError(
            '"oracle" needs the true error models (truth=, --oracle): only a simulator knows them. Leave it out.'
        )
    if series is None:
        series = residual_series(vehicle, mission, chosen, start) if chosen and fitted_kinds(names) else {}
    return {name: vehicle.with_error(**_models(name, vehicle, chosen, series, truth or {})) for name in names}


def fitted_kinds(names: Sequence[str]) -> tuple[str, ...]:
    """Those of the models that are fitted to a whole mission beforehand."""
    return tuple(name for name in names if name in _FITS)


def learnable(vehicle: Vehicle, mission: Mission) -> tuple[str, ...]:
    """Correcting sensors with readings of their own, and enough of them to fit a model to."""
    found = []
    for name, sensor in vehicle.sensors.items():
        if sensor.open_loop and name in mission.streams:
            known = np.isfinite(mission.streams[name].value[:, : sensor.reads]).any(axis=1)
            if np.count_nonzero(known) >= LEAST:
                found.append(name)
    return tuple(found)


def _check_sensors(vehicle: Vehicle, names: Sequence[str]) -> None:
    for name in names:
        if name not in vehicle.sensors or not vehicle.sensors[name].open_loop:
            have = ", ".join(key for key, sensor in vehicle.sensors.items() if sensor.open_loop) or "none"
            raise ValueError(
                f'"{name}" is no sensor of this vehicle whose error could be modelled from its readings (there are: '
                f"{have})."
            )


def _models(
    kind: str, vehicle: Vehicle, names: Sequence[str], series: Series, truth: Mapping[str, Errors]
) -> dict[str, Errors]:
    if kind == "vehicle":
        return {}
    if kind == "oracle":
        return {name: model for name, model in truth.items() if name in vehicle.sensors}
    found: dict[str, Errors] = {}
    for name in names:
        priors = vehicle.sensors[name].models
        if kind == "arma":
            models = tuple(_learning(prior) for prior in priors)
        elif kind in RULES:
            models = tuple(as_white(prior, 1.0 / vehicle.sensors[name].rate_hz) for prior in priors)
        else:
            models = tuple(_fitted(kind, channel, prior) for channel, prior in zip(series[name], priors, strict=True))
        found[name] = models[0] if len(models) == 1 else models
    return found


def _split(model: ErrorModel) -> tuple[list[ErrorModel], list[ErrorModel]]:
    """Random walks, which are the bias of a sensor and stay as they are in every rival, and the rest."""
    walks: list[ErrorModel] = [part for part in model.terms if isinstance(part, RandomWalk)]
    return walks, [part for part in model.terms if not isinstance(part, RandomWalk)]


def _learning(prior: ErrorModel) -> ErrorModel:
    """The axis learns, from its model in the vehicle file on; one that learns already is left as it is."""
    if learned_part(prior) is not None:
        return prior
    walks, rest = _split(prior)
    return sum_of([*walks, LearnedArma(prior=sum_of(rest) if rest else None)])


# --- fits -----------------------------------------------------------------------------------------------------------


def _fitted(kind: str, channel: ChannelSeries, prior: ErrorModel) -> ErrorModel:
    """The model of one axis; that of the vehicle file where there are too few readings, or they never change."""
    known = channel.value[np.isfinite(channel.value)]
    if known.size < LEAST or np.ptp(known) == 0.0:
        return prior
    # White noise that stands beside a learnt part is the sensor's and to be fitted; what is known to be white beyond it
    # is not.
    white = max(channel.white - known_white(prior, channel.period_s), 0.0)
    return sum_of([*_split(prior)[0], _FITS[kind](channel, white)])


def _white(channel: ChannelSeries, white: float) -> ErrorModel:
    from navfilter.learning.arma_fit import fit_channel

    return White(sd=float(fit_channel(channel.value, channel.drift, 0, 0, white=white).model.sd))


def _gm1_fitted(channel: ChannelSeries, white: float) -> ErrorModel:
    """Order (1, 0) of the channel: ``x[t] = phi x[t-1] + e`` is the sampled Gauss-Markov process with ``phi =
    exp(-period/tau)``.
    """
    from navfilter.learning.arma_fit import fit_channel

    model = fit_channel(channel.value, channel.drift, 1, 0, white=white).model
    phi = -float(model.ar[0])
    if phi <= 0.0:
        # No such process alternates; the best one is that whose time constant goes to zero.
        return _white(channel, white)
    phi = min(phi, 1.0 - 1e-9)
    return GaussMarkov(sd=float(model.sd) / math.sqrt(1.0 - phi * phi), tau_s=-channel.period_s / math.log(phi))


def _gm1(channel: ChannelSeries, white: float) -> ErrorModel:
    """The thesis's way: autocorrelation of the detrended series, and where it falls to 1/e.

    The detrending polynomial has the degree that the slow navigation error would have without noise: it is a chain of
    integrators.
    """
    value = _longest_stretch(channel.value)
    at = np.linspace(-1.0, 1.0, value.size)
    known = np.isfinite(value)
    trend = np.polynomial.Polynomial.fit(at[known], value[known], max(channel.drift.order - 1, 0))
    fit = fit_gauss_markov(np.where(known, value - trend(at), np.nan), 1, 1.0 / channel.period_s, method="1/e")
    return GaussMarkov(sd=fit.sd, tau_s=fit.tau_s)


def _longest_stretch(value: Array, gap: int = 40, least: int = 50) -> Array:
    """The stretch with most readings between gaps of more than `gap` missing ones; all of it where that leaves too
    little.
    """
    known = np.flatnonzero(np.isfinite(value))
    best = max(np.split(known, np.flatnonzero(np.diff(known) > gap) + 1), key=len)
    return value if best.size < least else value[best[0] : best[-1] + 1]


_FITS: dict[str, Callable[[ChannelSeries, float], ErrorModel]] = {
    "white": _white,
    "gm1": _gm1,
    "gm1-fitted": _gm1_fitted,
}
