"""A fitted ARMA model in plain words: bias, Gauss-Markov, lines, device filtering, white noise; and the error model to
use.

The spectrum is split into one term per pole (partial fractions) plus what is left, and each term is named by where its
pole lies with its uncertainty. A model that is no such sum of independent noises is described by its poles alone.
"""

import math
from dataclasses import dataclass

import numpy as np

from navfilter.foundation.arrays import Complex
from navfilter.models.error_models import Arma, ErrorModel, GaussMarkov, RandomWalk, White, sum_of
from navfilter.timeseries.model import ArmaModel, split_bias
from navfilter.timeseries.roots import cap_poles, has_unit_root, resolved_radius, root_sd, time_constant

#: A correlation that falls to 1/e within this many samples is the device's own filtering, not drift.
SHORT_SAMPLES = 3.0
#: Damping above which a pair of poles is no oscillation but a smooth second-order process.
SMOOTH = 0.75
#: Damping below which a pair of poles rings for more than a period: a line.
RINGING = 0.16
#: Half of beta * tau = 2.1462 of a second-order Gauss-Markov process: its 1/e time from the memories of its two poles.
SECOND = 1.0731
#: White noise of a smaller share of the innovation's variance is not worth a word.
NEGLIGIBLE = 0.01
#: Nor is another part whose density, at its own frequency, stays below this share of the innovation's.
INVISIBLE = 0.3


@dataclass(frozen=True)
class Component:
    """One part of the noise.

    Attributes
    ----------
    kind : str
        "random walk", "correlated walk", "gauss-markov", "second order", "oscillation", "line", "short", "moving
        average" or "white".
    sd : float
        Its standard deviation in the unit of the series (random walk: step per sample; NaN where it cannot be told).
    tau_s, tau_sd_s : float
        Correlation time and its standard deviation (NaN where it has none).
    freq_hz : float
        Frequency of a line or of a pair of poles (NaN otherwise).
    """

    kind: str
    sd: float
    tau_s: float = math.nan
    tau_sd_s: float = math.nan
    freq_hz: float = math.nan


@dataclass(frozen=True)
class Reading:
    """What the model means.

    Attributes
    ----------
    text : str
        One sentence: the parts, and the minimal order.
    details : str
        The same parts with their sizes.
    components : tuple of Component
        Its parts, slowest first.
    minimal : tuple of int
        Order (p, q) with unit roots counted as poles and cancelling pairs left out.
    error : ErrorModel
        What to give to a sensor.
    """

    text: str
    details: str
    components: tuple[Component, ...]
    minimal: tuple[int, int]
    error: ErrorModel


def read_model(model: ArmaModel, rate_hz: float, n: int, unit: str = "", white: bool = True, d: int = 0) -> Reading:
    """Put a model into words.

    Parameters
    ----------
    model : ArmaModel
        With its covariance; unit roots of differencing are part of its AR polynomial.
    rate_hz : float
        Sampling rate.
    n : int
        Samples behind it: a pole above ``1 - 3/n``, or one that a unit-root test cannot tell from 1, is bias.
    unit : str
        Unit of the series, for the text.
    white : bool
        Whether the residuals were white; said in the text if not.
    d : int
        Times the series was differenced.

    Examples
    --------
    >>> model = ArmaModel([-1.0], [-0.982], 1.0, np.diag([1e-6, 1e-5]))
    >>> read_model(model, 100.0, 14400).text
    'random-walk bias + white noise; minimal order (1,1)'
    """
    parts, error = _parts(model, rate_hz, n, d)
    names = list(dict.fromkeys(_name(part, rate_hz) for part in parts))
    text = f"{' + '.join(names)}; minimal order ({model.p},{model.q})"
    if not white:
        text += "; the residuals are not white: an approximation"
    details = "; ".join(_size(part, rate_hz, unit) for part in parts if math.isfinite(part.sd))
    return Reading(text, details, tuple(parts), (model.p, model.q), error)


def _parts(model: ArmaModel, rate_hz: float, n: int, d: int) -> tuple[list[Component], ErrorModel]:
    covariance = np.zeros((model.p + model.q,) * 2) if model.covariance is None else model.covariance
    if d or (model.p and has_unit_root(model.ar, covariance, n)):
        try:
            walk, rest = split_bias(model)
        except ValueError:
            return _inseparable(model, rate_hz, n, d)
        if rest.is_stable:
            bias = Component("random walk", walk)
            others = stationary_parts(rest, rate_hz) if rest.sd > 0.0 else []
            error: ErrorModel = RandomWalk(density=_rounded(walk * math.sqrt(rate_hz)))
            return [bias, *others], error + _error_of(others, rest) if others else error
        return _inseparable(model, rate_hz, n, d)
    parts = stationary_parts(model, rate_hz)
    return parts, _error_of(parts, model)


def _inseparable(model: ArmaModel, rate_hz: float, n: int, d: int) -> tuple[list[Component], ErrorModel]:
    """A unit root whose walk cannot be taken out as an independent noise: a walk with correlated steps, held stable."""
    roots = sorted(range(model.p), key=lambda i: abs(model.poles[i] - 1.0))
    steps = np.delete(model.poles, roots[: max(d, 1)])
    tail = ArmaModel(np.atleast_1d(np.real(np.poly(steps)))[1:], model.ma, model.sd)
    size = model.sd * abs(1.0 + float(model.ma.sum())) / max(abs(1.0 + float(tail.ar.sum())), 1e-300)
    held = ArmaModel(cap_poles(model.ar, resolved_radius(n)), model.ma, model.sd)
    return [Component("correlated walk", size), *_by_poles(tail, rate_hz)], _arma(held)


# --- parts of a stationary model ------------------------------------------------------------------------------------


def stationary_parts(model: ArmaModel, rate_hz: float) -> list[Component]:
    """The parts of a model that is taken for stationary, however near to 1 its poles are, the slowest first.

    Parameters
    ----------
    model : ArmaModel
    rate_hz : float
        Sampling rate.

    Returns
    -------
    list of Component
        With the standard deviation of each where the model is such a sum of independent parts, else named by its poles
        alone.
    """
    if not model.p:
        return [Component("moving average", math.sqrt(model.variance))] if model.q else [Component("white", model.sd)]
    poles = model.poles
    power = _powers(model, poles)
    if model.q < model.p and model.p == 1:
        left = 0.0
    else:
        left = _left_over(model, poles, power)
    parts = [_component(model, rate_hz, p, v) for p, v in zip(poles, power, strict=True) if p.imag >= 0.0]
    if left < -0.02 * model.sd**2 or any(not part.sd >= 0.0 for part in parts):
        return _by_poles(model, rate_hz)
    parts = [part for part in parts if _shows(part, model.sd, rate_hz)]
    short = [part for part in parts if part.kind == "short"]
    if len(short) > 1:
        merged = Component("short", math.sqrt(sum(part.sd**2 for part in short)), max(part.tau_s for part in short))
        parts = [part for part in parts if part.kind != "short"] + [merged]
    parts.sort(key=lambda part: (_RANK[part.kind], -part.tau_s if part.tau_s == part.tau_s else 0.0))
    if left > NEGLIGIBLE * model.sd**2:
        parts.append(Component("white", math.sqrt(left)))
    return parts


_RANK = {"gauss-markov": 0, "second order": 1, "oscillation": 2, "line": 3, "short": 4, "moving average": 5, "white": 6}


def _shows(part: Component, innovation_sd: float, rate_hz: float) -> bool:
    """Whether a part rises out of the spectrum: 2 tau samples gather its variance, a line's is spread over two
    sides.
    """
    gathered = max(2.0 * part.tau_s * rate_hz / (2.0 if part.kind == "line" else 1.0), 1.0)
    return part.sd**2 * gathered > INVISIBLE * innovation_sd**2


def _by_poles(model: ArmaModel, rate_hz: float) -> list[Component]:
    """Parts named by their poles alone, without a power of their own."""
    parts: list[Component] = []
    real = [p for p in model.poles if p.imag == 0.0 and p.real > 0.0 and time_constant(p) > SHORT_SAMPLES]
    if len(real) >= 2 and time_constant(real[0]) < 3.0 * time_constant(real[1]):
        # Two neighbouring real poles without independent parts: one smooth process, faster pole well within a factor.
        slow = real[:2]
        tau = SECOND * sum(time_constant(p) for p in slow) / rate_hz
        parts.append(Component("second order", math.nan, tau))
        rest = [p for p in model.poles if all(p != s for s in slow)]
    else:
        rest = list(model.poles)
    parts += [_component(model, rate_hz, p, math.nan) for p in rest if p.imag >= 0.0]
    parts.sort(key=lambda part: (_RANK[part.kind], -part.tau_s if part.tau_s == part.tau_s else 0.0))
    return parts


def _component(model: ArmaModel, rate_hz: float, pole: complex, power: float) -> Component:
    """Name one pole (of a pair: the upper one)."""
    sd = math.sqrt(power) if power >= 0.0 else math.nan
    memory = time_constant(pole)
    tau, freq = memory / rate_hz, abs(float(np.angle(pole))) / (2.0 * math.pi) * rate_hz
    if memory < SHORT_SAMPLES:
        return Component("short", sd, tau)
    spread = math.inf if model.covariance is None else root_sd(model.ar, model.covariance[: model.p, : model.p], pole)
    tau_sd = float(tau * spread * memory / abs(pole))
    if pole.imag == 0.0 and pole.real > 0.0:
        return Component("gauss-markov", sd, tau, tau_sd)
    s = np.log(complex(pole))
    damping = -s.real / abs(s)
    if damping > SMOOTH:
        return Component("second order", sd, 2.0 * SECOND * tau, 2.0 * SECOND * tau_sd, freq)
    return Component("line" if damping < RINGING else "oscillation", sd, tau, tau_sd, freq)


def _powers(model: ArmaModel, poles: Complex) -> list[float]:
    """Variance of each pole's term of the spectrum (of a pair: of both together)."""
    ma = np.r_[1.0, model.ma][::-1]
    powers = []
    for i, p in enumerate(poles):
        others = np.delete(poles, i)
        scale = np.prod(1.0 - others * p) * np.prod(1.0 - others / p) if p != 0.0 else 0.0
        if scale == 0.0:
            powers.append(0.0 if p == 0.0 else math.nan)
            continue
        residue = model.sd**2 * np.polyval(ma, p) * np.polyval(ma, 1.0 / p) / scale
        powers.append(float((residue / (1.0 - p * p)).real) * (2.0 if p.imag != 0.0 else 1.0))
    return powers


def _left_over(model: ArmaModel, poles: Complex, power: list[float]) -> float:
    """Variance that no pole carries: white noise when q = p, none when q < p."""
    own = sum(v / (2.0 if p.imag != 0.0 else 1.0) for p, v in zip(poles, power, strict=True))
    return model.variance - own


# --- words and numbers ----------------------------------------------------------------------------------------------


def _name(part: Component, rate_hz: float) -> str:
    tau = f"tau = {seconds_text(part.tau_s)}"
    if 0.0 < part.tau_sd_s < part.tau_s:
        tau += f" +- {seconds_text(part.tau_sd_s)}"
    where = "near Nyquist" if part.freq_hz > 0.45 * rate_hz else f"at {number(part.freq_hz, 3)} Hz"
    return {
        "random walk": "random-walk bias",
        "correlated walk": "random walk with correlated steps",
        "gauss-markov": f"first-order Gauss-Markov, {tau}",
        "second order": f"second-order Gauss-Markov, {tau}",
        "oscillation": f"damped oscillation {where}",
        "line": f"a line {where}",
        "short": "short correlation from the device's own filtering",
        "moving average": "moving average from the device's own filtering",
        "white": "white noise",
    }[part.kind]


def _size(part: Component, rate_hz: float, unit: str) -> str:
    """The part's name with its strength."""
    name = {"gauss-markov": "Gauss-Markov", "second order": "second order", "short": "short correlation"}.get(
        part.kind, part.kind
    )
    if part.kind in ("random walk", "correlated walk"):
        per = f"{unit}/sqrt(s)" if unit else "per sqrt(s)"
        return f"{name} {number(part.sd * math.sqrt(rate_hz), 3)} {per}"
    if part.kind == "line":
        name += " near Nyquist" if part.freq_hz > 0.45 * rate_hz else f" at {number(part.freq_hz, 3)} Hz"
    size = f"sd {number(part.sd)}{' ' + unit if unit else ''}"
    return f"{name} {size}" + (
        f", lasting {seconds_text(part.tau_s)}" if part.kind in ("line", "oscillation", "short") else ""
    )


def number(value: float, digits: int = 4) -> str:
    """`digits` significant digits, plain where that is readable."""
    if value == 0.0 or not math.isfinite(value):
        return f"{value:g}"
    return f"{value:#.{digits}g}".rstrip(".") if 1e-4 <= abs(value) < 1e6 else f"{value:.{digits - 1}e}"


def seconds_text(seconds: float) -> str:
    """A time in words."""
    return f"{number(seconds, 2)} s" if seconds < 10.0 else f"{seconds:.0f} s"


def _rounded(value: float, digits: int = 6) -> float:
    return float(f"{value:.{digits}g}")


def _error_of(parts: list[Component], model: ArmaModel) -> ErrorModel:
    """Independent parts where the model is such a sum, else the ARMA model itself."""
    simple = {"gauss-markov", "white"}
    if all(part.kind in simple and math.isfinite(part.sd) for part in parts):
        models: list[ErrorModel] = []
        for part in parts:
            if part.kind == "white":
                models.append(White(sd=_rounded(part.sd)))
            else:
                models.append(GaussMarkov(sd=_rounded(part.sd), tau_s=_rounded(part.tau_s)))
        return sum_of(models)
    return _arma(model)


def _arma(model: ArmaModel) -> Arma:
    # Ten digits: poles of a high order near 1 move by far more than its coefficients are rounded.
    ar, ma = (tuple(_rounded(c, 10) for c in values.tolist()) for values in (model.ar, model.ma))
    try:
        return Arma(ar=ar, ma=ma, sd=_rounded(model.sd))
    except ValueError:
        return Arma(ar=tuple(cap_poles(model.ar, 0.9999).tolist()), ma=ma, sd=_rounded(model.sd))
