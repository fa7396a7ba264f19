"""Constants that a vehicle.toml leaves out and the mission tells: a clock, a lever arm, a scale, a mounting, a bias.

A statistic of the residuals shows some of these and not others: a scale is in no residual of a DVL that the state
follows, a mounting looks like a heading. What knows how each of them would show is the filter itself. The mission is
run once more with all of them as states that may hardly move: what the readings say of them is then told by how far
they would have moved, while the run stays what it was. What stands out is tried: the mission is run with that constant
described, and it is said where the readings are then much likelier.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from navfilter.calibration.calibrate import said
from navfilter.calibration.parts import KINDS, Constant, closed, constants_of, described, kind_of, opened
from navfilter.check.course import WRONG, part_of, stated_direction
from navfilter.check.finding import Finding, Severity
from navfilter.check.units_text import amount
from navfilter.filter.records import OUTCOMES, Residuals
from navfilter.foundation.arrays import Array, Mask
from navfilter.learning.batch import learning_sensors
from navfilter.models.error_models import ErrorModel
from navfilter.models.fault_bias import has_offset
from navfilter.models.learned_arma import learning_part, with_learned
from navfilter.models.mission import Mission
from navfilter.models.vehicle import Vehicle
from navfilter.playback.replay import learns, replay
from navfilter.track.track import Track

#: Share of its sd by which a constant may move while the run is to stay what it was.
HARDLY = 0.03
#: A constant is tried whose evidence (the logarithm of how much likelier the readings are with it than without) is
#: above the first, and said above the second, by chance one of three thousand, where its trial gains the third. Where a
#: run has rejected what the trial uses, readings say little of it before: the trial alone decides.
WORTH_A_TRIAL, EVIDENCE, GAIN = 3.0, 8.0, 5.0
#: What is worth a trial where the state was set anew, or a sensor was off by a constant.
WORTH_IN_RUINS = 1.0
#: Others are tried that explain at least this share of what the best explains; and of those whose trials gain at least
#: so much of the best's, the evidence decides.
AS_WELL, GAINS = 0.3, 0.5
#: So many are tried at most, and so many said one after the other.
TRIED, ROUNDS = 3, 3
#: Constants whose evidence differs by less than this explain the readings alike.
ALIKE = 5.0
#: A trial that rejects less than this share of what the run rejected, and so many fewer, is another run.
REJECTS, FEWER = 0.5, 5
#: One of what is found must be beyond the first of these in standard deviations; those beyond the second are said.
FOUND, WORTH_SAYING = 4.0, 2.0
#: One that is beyond so many of what such constants usually are has another cause: an axis, a sign, a unit.
TOO_FAR = 6.0
#: Where a sensor still scatters by more than this (NIS) its noise is described wrong, and tells constants that are
#: none.
SCATTERS = 2.0
#: A rejected reading counts as one so far off (NIS over its components): how far it really is, nobody knows.
REJECTED = 20.0
#: A track that goes elsewhere by less than this (mean square, in predicted variances) is what it was: a remark.
ELSEWHERE = 0.5
WORDS = {
    "clock": "its clock is off",
    "lever-arm": "its lever arm is off",
    "scale": "its scale is off",
    "mounting": "it is mounted otherwise",
    "bias": "it has a bias, if it does not deviate",
    "deviation": "it deviates with the heading",
    "iron": "there is iron about it",
    "offset": "it has an offset",
}
#: What to write for a kind; numbers in braces are standard deviations: at least the first, and wide enough for what
#: was found, in the unit of the key (the second, in SI).
KEYS: dict[str, tuple[str, float, float]] = {
    "clock": ("time_offset_sd_s = {0:g}", 0.3, 1.0),
    "lever-arm": ("lever_arm_sd_m = [{0:g}, {0:g}, {0:g}]", 0.5, 1.0),
    "scale": ("scale_sd = {0:g}", 0.02, 1.0),
    "mounting": ("misalignment_sd_deg = {0:g}", 3.0, math.radians(1.0)),
    "bias": ("bias_sd_deg = {0:g}, and perhaps deviation_sd_deg = [5.0, 2.0],", 5.0, math.radians(1.0)),
    "deviation": ("bias_sd_deg = {0:g} and deviation_sd_deg = [{0:g}, 2.0]", 5.0, math.radians(1.0)),
    "iron": ("hard_iron_sd and soft_iron_sd", 1.0, 1.0),
    "offset": ("offset_sd_m = {0:g}", 0.5, 1.0),
}
#: A constant error of the heading looks like lever arms and clocks of fixes, and not the other way round: where it
#: explains this share of what the best does, it is the cause.
CONSTANT_HEADING = ("mounting", "bias")


def key_of(kind: str, found: Sequence[float] = ()) -> str:
    """What to write into a vehicle.toml, with a standard deviation that does not refuse what was found [SI]."""
    text, usual, unit = KEYS[kind]
    largest = max(map(abs, found), default=0.0) / unit
    digit = 10.0 ** math.floor(math.log10(usual))
    return text.format(usual if largest <= usual else math.ceil(largest / digit) * digit)


class _Cause(NamedTuple):
    """Constants of one kind of one part of the vehicle: where it stands, and which of all constants they are."""

    part: tuple[str, ...]
    kind: str
    at: tuple[int, ...]


class Apart(NamedTuple):
    """How far two tracks lie apart.

    Attributes
    ----------
    most, predicted : float
        At most, and the rms that the first predicted there [m] or [rad].
    square : float
        Mean square in predicted variances [1].
    """

    most: float
    predicted: float
    square: float


class LeftOut(NamedTuple):
    """A constant that the vehicle leaves out and the mission tells.

    Attributes
    ----------
    part : tuple of str
        Where its key belongs in a vehicle.toml: ("sensors", "gps").
    kind : str
        Of `navfilter.calibration.parts.KINDS`, or "bias".
    found : tuple of (str, str, float, float)
        Name within the part, unit, value and standard deviation of those that are not zero.
    evidence, gain : float
        Logarithm of how much likelier the readings are with it: as the run tells, and as the trial did.
    moved : Apart
        How far the track of the trial lies from the one that is judged.
    turned : Apart
        The same of the heading.
    alike : tuple of (tuple of str, str)
        Part and kind of others that explain the readings as well.
    """

    part: tuple[str, ...]
    kind: str
    found: tuple[tuple[str, str, float, float], ...]
    evidence: float
    gain: float
    moved: Apart
    turned: Apart
    alike: tuple[tuple[tuple[str, ...], str], ...] = ()


def left_out_doubts(run: Track, mission: Mission) -> Iterator[Finding]:
    """What the vehicle leaves out, with the key to add.

    Parameters
    ----------
    run : Track
        Forward.
    mission : Mission
        As it was replayed.
    """
    for one in left_out(run, mission):
        values = ", ".join(f"{own} {amount(value, unit)} (sd {amount(sd, unit)})" for own, unit, value, sd in one.found)
        text = f"{WORDS[one.kind]}, as all readings together tell: {values}. {_goes(one)}"
        cure = (
            f"Add {key_of(one.kind, [value for _, _, value, _ in one.found])} to [{'.'.join(one.part)}] of vehicle.toml"
        )
        for part, kind in one.alike:
            text += f" As well it may be that {WORDS[kind]} ({part[-1]})."
            cure += f", or {key_of(kind)} to [{'.'.join(part)}]"
        grade: Severity = "warning" if max(one.moved.square, one.turned.square) > ELSEWHERE else "info"
        if grade == "warning" and _is_turned(one, run):
            grade = "error"
        yield Finding(grade, "omitted", one.part[-1], text, f"{cure}; 'navfilter calibrate' then finds it.")


def _is_turned(one: LeftOut, run: Track) -> bool:
    """Whether a direction is off by more than its description allows, and surely: the track is turned by as much."""
    if one.kind not in CONSTANT_HEADING:
        return False
    speed_m_s = float(np.sqrt(np.mean(np.sum(run.velocity_n[:, :2] ** 2, axis=1))))
    stated = stated_direction(part_of(run.vehicle, one.part[-1]), speed_m_s)
    about_z = [(abs(value), sd) for own, unit, value, sd in one.found if unit == "rad" and own[-2:] not in ("_x", "_y")]
    return any(value > max(WRONG * sd, stated) for value, sd in about_z)


def _goes(one: LeftOut) -> str:
    """What it does to the track."""
    if one.turned.square > one.moved.square:
        what, unit, apart = "heading then is up to", "rad", one.turned
    else:
        what, unit, apart = "track then goes up to", "m", one.moved
    most, predicted = amount(apart.most, unit), amount(apart.predicted, unit)
    return f"With that the {what} {most} beside this one, where {predicted} (rms) were predicted."


def left_out(run: Track, mission: Mission) -> tuple[LeftOut, ...]:
    """Constants that the vehicle of a run leaves out and the mission tells; the clearest first.

    Parameters
    ----------
    run : Track
        Forward.
    mission : Mission
        As it was replayed.

    Notes
    -----
    With all constants as states of a small standard deviation ``s`` the end of the run gives their information ``J``
    and the vector ``i = J c`` (`navfilter.calibration.calibrate.said`), linear around the run as it was. The evidence
    for some of them with the prior ``N(0, S)`` is then ``i' inv(J + inv(S)) i / 2 - log det(1 + S J) / 2``: a score
    test with the price of what is added (Rao, 1948; Kass and Raftery, 1995). Those of the description itself are
    always among them.
    """
    vehicle = _of_run(run)
    if vehicle is None:
        return ()
    if vehicle is not run.vehicle:
        run = replay(vehicle, mission, output_rate_hz=1.0)
    first, found = run, list[LeftOut]()
    for _ in range(ROUNDS):
        everything = opened(run.vehicle, tuple(KINDS), [mission])
        tried = [_tried(run, first, mission, everything, *one) for one in _standing_out(run, mission, everything)]
        good = [one for one in tried if one is not None]
        if not good:
            break
        most = GAINS * max(one.gain for one, _ in good)
        good = sorted(
            (one for one in good if one[0].gain >= most),
            key=lambda one: (one[0].kind not in CONSTANT_HEADING, -one[0].evidence),
        )
        (best, track), others = good[0], good[1:]
        alike = tuple((one.part, one.kind) for one, _ in others if best.evidence - one.evidence < ALIKE)
        found.append(best._replace(alike=alike))
        run = track
    described_wrong = any(_nis(r) > SCATTERS for name, r in run.residuals.items() if name in run.vehicle.sensors)
    return () if described_wrong else tuple(found)


def _of_run(run: Track) -> Vehicle | None:
    """The vehicle of a run with the models that it has learnt; None where there is nothing to be tried."""
    vehicle = run.vehicle
    if run.lanes or not np.isfinite(run.covariance).all():
        return None
    if not learns(vehicle):
        return vehicle
    models = {name: run.error_models[name][-1][1] for name in learning_sensors(vehicle)}
    if any(not isinstance(own, tuple) or has_offset(own) for own in models.values()):
        return None  # nothing learnt yet, or only the changes of its readings were used in the end
    frozen = vehicle.with_error(**{name: tuple(map(_frozen, own)) for name, own in models.items()})
    return None if learns(frozen) else frozen


def _frozen(model: ErrorModel) -> ErrorModel:
    """The model as it was learnt, to be kept."""
    part = learning_part(model)
    return model if part is None or part.model is None else with_learned(model, replace(part, frozen=True))


def _standing_out(run: Track, mission: Mission, everything: Vehicle) -> list[tuple[float, _Cause]]:
    """What is worth a trial, the clearest first, with its evidence."""
    constants, own = constants_of(everything), {one.name for one in constants_of(run.vehicle)}
    grouped: dict[tuple[tuple[str, ...], str], list[int]] = {}
    for k, one in enumerate(constants):
        if one.name not in own:
            kind = "bias" if one.own == "bias" else kind_of(one.own)
            grouped.setdefault((one.part, kind), []).append(k)
    causes = [_Cause(part, kind, tuple(at)) for (part, kind), at in grouped.items()]
    if not causes:
        return []
    score = _scores(mission, everything, constants, own)
    if score is None:
        return []
    J, i, sd = score
    described_ones = [k for k, one in enumerate(constants) if one.name in own]
    without = _evidence(J, i, sd, described_ones)
    scored = sorted(((_evidence(J, i, sd, [*described_ones, *c.at]) - without, c) for c in causes), reverse=True)
    ruins = any(run.counts.get(event, 0) for event in ("reset", "jumped", "opened", "contradicted", "arm-or-clock"))
    least = max(WORTH_IN_RUINS if ruins else WORTH_A_TRIAL, AS_WELL * scored[0][0])
    tried = scored[:TRIED]
    # the constant error of a heading is tried in any case, see `CONSTANT_HEADING`
    tried += [one for one in scored[TRIED:] if one[1].kind in CONSTANT_HEADING][:1]
    return [(gain, cause) for gain, cause in tried if gain > least]


def _scores(
    mission: Mission, everything: Vehicle, constants: Sequence[Constant], own: set[str]
) -> tuple[Array, Array, Array] | None:
    """Information of the mission on all constants, that times their values beyond the described ones, and the priors'
    sd; None where the run came to nothing.
    """
    value, sd = (np.array([getattr(one, key) for one in constants]) for key in ("value", "sd"))
    small = np.array([1.0 if one.name in own else HARDLY for one in constants]) * sd
    still = described(everything, [one._replace(sd=float(s)) for one, s in zip(constants, small, strict=True)])
    try:
        J, i = said(still, mission, constants, value, small)
    except np.linalg.LinAlgError:
        return None
    i = i - J @ value
    return (J, i, sd) if np.isfinite(J).all() and np.isfinite(i).all() else None


def _evidence(J: Array, i: Array, sd: Array, at: Sequence[int]) -> float:
    """Logarithm of how much likelier the readings are where these constants may be what they are."""
    if not at:
        return 0.0
    k = list(at)
    A = J[np.ix_(k, k)] * np.outer(sd[k], sd[k]) + np.eye(len(k))
    b = i[k] * sd[k]
    return float(0.5 * b @ np.linalg.solve(A, b) - 0.5 * np.linalg.slogdet(A)[1])


def _tried(
    run: Track, first: Track, mission: Mission, everything: Vehicle, evidence: float, cause: _Cause
) -> tuple[LeftOut, Track] | None:
    """A run with these constants described, where it bears them out."""
    constants = constants_of(everything)
    own = {one.name for one in constants_of(run.vehicle)}
    mine = [constants[k] for k in cause.at]
    names = {one.name for one in mine}
    untold = [one for one in constants if one.name not in own and one.name not in names]
    track = replay(closed(everything, run.vehicle, untold), mission, output_rate_hz=1.0)
    at = {name: k for k, name in enumerate(track.state_names)}
    begin = {one.name: 0.0 if one.folded else one.value for one in mine}
    found, far = [], 0.0
    for one in mine:
        k = at[one.name]
        value, sd = float(track.states[-1, k]) - begin[one.name], float(track.states_sd[-1, k])
        far = max(far, abs(value) / sd)
        if abs(value) > TOO_FAR * one.sd:
            return None
        if abs(value) > WORTH_SAYING * sd:
            found.append((one.own, one.unit, value, sd))
    gain = _gain(run, track)
    before, after = _rejected(run), _rejected(track)
    let_in = after < REJECTS * before and before - after >= FEWER
    # far from what is usual a score understates: then the trial decides
    trial_decides = (let_in or cause.kind in CONSTANT_HEADING) and gain > EVIDENCE
    if far < FOUND or gain < GAIN or (evidence < EVIDENCE and not trial_decides):
        return None
    return LeftOut(cause.part, cause.kind, tuple(found), evidence, gain, *_moved(first, track)), track


def _rejected(run: Track) -> int:
    """Readings that contradicted the run, and how often a description was found to be wrong by them."""
    return sum(r.count("rejected") for r in run.residuals.values()) + run.counts.get("arm-or-clock", 0)


def _nis(r: Residuals) -> float:
    return float(np.mean(r.nis[r.used] / np.maximum(r.dof[r.used], 1.0))) if r.used.any() else 0.0


def _gain(before: Track, after: Track) -> float:
    """Logarithm of how much likelier the readings are in the second run."""
    total = 0.0
    for name, r in before.residuals.items():
        other = after.residuals.get(name)
        if other is None or len(other.time_s) != len(r.time_s):
            continue
        both = np.isfinite(r.nis) & np.isfinite(other.nis) & (_judged(r) & _judged(other))
        total += float(np.sum(_likelihood(other)[both] - _likelihood(r)[both]))
    return total


def _judged(r: Residuals) -> Mask:
    return r.used | (r.outcome == OUTCOMES.index("rejected"))


def _likelihood(r: Residuals) -> Array:
    """Of each reading: logarithm, but for a constant."""
    spread = np.where(np.isfinite(r.sd) & (r.sd > 0.0), r.sd, 1.0)
    nis = np.minimum(r.nis, REJECTED * np.maximum(r.dof, 1.0))
    return np.asarray(-0.5 * nis - np.sum(np.log(spread), axis=1))


def _moved(before: Track, after: Track) -> tuple[Apart, Apart]:
    """How far two tracks lie apart, and their headings."""
    one = before.keep((before.time_s >= after.time_s[0]) & (before.time_s <= after.time_s[-1]))
    other = after.at(one.time_s)
    origin = float(one.latitude[0]), float(one.longitude[0])
    place = (one.local(*origin) - other.local(*origin))[:, :3]
    turned = np.angle(np.exp(1j * (one.attitude[:, 2] - other.attitude[:, 2])))[:, None]
    variances = np.maximum(np.einsum("nii->ni", one.covariance), 1e-18)
    return _apart(place, variances[:, :3]), _apart(turned, variances[:, 8:])


def _apart(difference: Array, variance: Array) -> Apart:
    far = np.sqrt(np.sum(difference**2, axis=1))
    worst = int(np.argmax(far))
    square = float(np.mean(difference**2 / variance))
    return Apart(float(far[worst]), math.sqrt(float(np.sum(variance[worst]))), square)
