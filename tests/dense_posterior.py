"""A run of the navigator as one linear Gaussian chain, that chain conditioned in one piece, and vehicles to try it on.

Every run is captured as its chain ``e- = Phi e + w, res = H e- + v, e+ = G (e- - K res) + u`` of errors (true minus
estimated), G the reset of the attitude. Where a constant is only considered, it walks by as much as it would have been
told: u, and the estimate goes with it.
"""

import math
from dataclasses import dataclass, replace

import naive
import numpy as np
from scipy.linalg import block_diag

import navfilter as nf
from navfilter.filter import filter as engine
from navfilter.filter.records import triangle
from navfilter.filter.rts_smoother import smooth_rows
from navfilter.kernels import batch, kalman

DEG = np.pi / 180.0
#: Kinds that stand in for others, and what their readings look like below.
LIKE = {
    **{nf.DvlBeams: "beams", nf.Range: "range", nf.Usbl: "usbl", nf.Attitude: "ahrs"},
    **{nf.Odometer: "wheels", nf.Course: "course", nf.Altitude: "altitude"},
}
ARMA = {"ar": (-1.6, 0.7), "ma": (0.4, 0.1)}


@dataclass
class Step:
    """One link of the chain over all n states; H is None where nothing was corrected."""

    Phi: np.ndarray
    Q: np.ndarray
    H: np.ndarray | None = None
    R: np.ndarray | None = None
    res: np.ndarray | None = None
    K: np.ndarray | None = None
    G: np.ndarray | None = None
    U: np.ndarray | None = None


class Capture:
    """Runs a navigator by the readable twin of the kernel that corrects, and notes the chain: folds, corrections,
    single samples.
    """

    #: Parts of the twin that are noted.
    PARTS = ("attitude_second_order", "predict", "update", "turn_velocity", "turn_tilts", "turn_current")

    def __init__(self, monkeypatch, vehicle, start):
        self.steps, self.samples, self.frozen = [], [], False
        monkeypatch.setattr(engine, "kalman", self)
        monkeypatch.setattr(engine, "consistency", self)
        self.twins = {name: getattr(naive, name) for name in self.PARTS}
        for name in self.PARTS:
            monkeypatch.setattr(naive, name, getattr(self, name))
        for name in ("consider_lever_arm", "consider_hidden", "consider_unit"):
            monkeypatch.setattr(naive, name, self._considering(getattr(naive, name)))
        self.tape = nf.Tape()
        self.nav = nf.Navigator(vehicle, start, self.tape)
        compiled, address = batch.correction, engine.address
        monkeypatch.setattr(batch, "correction", naive.correction)
        monkeypatch.setattr(
            engine, "address", lambda kernel, of: address(compiled if kernel is naive.correction else kernel, of)
        )
        self.P0, self.n = self.nav.filter.P.copy(), len(self.nav.filter.P)
        run = self.nav.filter
        run.steps, run.hold = self._each(run.steps, True), self._each(run.hold, False)
        self._single = []

    def __getattr__(self, name):
        return getattr(kalman, name)

    def _considering(self, twin):
        """What a constant is told too much of is given back: it walks."""

        def consider(P, *args):
            before = P.copy()
            twin(P, *args)
            for chain in (self.steps, self.samples):
                chain[-1].U = P - before + (0.0 if chain[-1].U is None else chain[-1].U)

        return consider

    def _each(self, kernel, block):
        """Run the drive's kernel sample by sample on a fresh compound, note each transition, and compound them here."""

        def run(nav, xd, drv, samples, Phid, Qd, Cr, acc):
            m = acc.shape[1]
            for sample in samples[:, None] if block else [samples]:
                one = np.vstack([np.eye(m), np.zeros((3 * m, m))])
                kernel(nav, xd, drv, sample, Phid, Qd, Cr, one)
                F, Q = one[:m], one[m : 2 * m]
                if self.frozen:
                    F[6:9], Q[6:9], Q[:, 6:9] = np.eye(3, m, 6), 0.0, 0.0
                self._single.append((F.copy(), Q.copy()))
                acc[:m], acc[m : 2 * m] = F @ acc[:m], F @ acc[m : 2 * m] @ F.T + Q

        return run

    def freeze_attitude(self):
        """From now on no error reaches the attitude."""
        self.frozen = True

    def _full(self, Phi, Q):
        rest = self.n - len(Phi)
        return Step(block_diag(Phi, np.eye(rest)), block_diag(Q, np.zeros((rest, rest))))

    def _flush(self):
        self.samples += [self._full(F, Q) for F, Q in self._single]
        self._single = []

    def attitude_second_order(self, P, acc, nav, own, work=None):
        """Of the single samples the first takes it: the heading's error is one from the fold before on. The last has
        the noise.
        """
        m = acc.shape[1]
        before = acc[: 2 * m].copy()
        self.twins["attitude_second_order"](P, acc, nav, own)
        if self._single:
            X, (F, Q) = np.eye(m), self._single[0]
            X[:9, 8] += np.linalg.solve(before[:9, :9], acc[:9, 8] - before[:9, 8])
            self._single[0] = F @ X, Q
            self._single[-1][1][:] += acc[m : 2 * m] - before[m:]

    def fold(self, P, acc, nav, work):
        m = acc.shape[1]
        self._flush()
        self.steps.append(self._full(acc[:m], self._bent(P, acc)))
        kalman.fold(P, acc, nav, work)

    def _bent(self, P, acc):
        """The noise of a transition, with what the second order of the heading adds; the last sample has it, too."""
        m = acc.shape[1]
        Q, after = acc[m : 2 * m].copy(), acc[:m] @ P[:m, :m] @ acc[:m].T
        bent = after.copy()
        naive.arc_term(P, bent)
        added = (bent - after)[:2, :2]
        Q[:2, :2] += added
        if self.samples and added.any():
            self.samples[-1].Q[:2, :2] += added
        return Q

    def turn_velocity(self, P, nav, before, change):
        self.twins["turn_velocity"](P, nav, before, change)
        for chain in (self.steps, self.samples):
            chain[-1].G = naive.velocity_turn(change[:3], self.n) @ chain[-1].G

    def turn_tilts(self, P, K, res, change):
        self.twins["turn_tilts"](P, K, res, change)
        for chain in (self.steps, self.samples):
            chain[-1].G = naive.tilts_turn(change, self.n) @ chain[-1].G

    def turn_current(self, P, K, res, first):
        self.twins["turn_current"](P, K, res, first)
        for chain in (self.steps, self.samples):
            chain[-1].G = naive.current_turn(K, res, first) @ chain[-1].G

    def predict(self, P, nav, x, acc, model, mem, dims, count):
        m, b, start = dims[2:5]
        self._flush()
        step, W = self._full(acc[:m], self._bent(P, acc)), np.zeros((2, b, b))
        naive.power(model[0], model[1], count, W)
        A, B, here = np.eye(self.n), np.zeros((self.n, self.n)), slice(start, start + b)
        A[here, here], B[here, here] = W
        for chain, link in ((self.steps, step), (self.samples, self._full(np.eye(m), np.zeros((m, m))))):
            chain.append(Step(A @ link.Phi, A @ link.Q @ A.T + B))
        self.twins["predict"](P, nav, x, acc, model, mem, dims, count)

    def update(self, P, nav, x, C, R, mem, dims, limits):
        at, a, n = kalman.memory_offsets(dims), dims[0], dims[1]
        before = P.copy()
        self.twins["update"](P, nav, x, C, R, mem, dims, limits)
        if not mem[at[8] + 2]:
            return
        H = mem[at[0] : at[1]].reshape(a, n).copy()
        missing = ~H.any(axis=1)
        white = R.copy()
        white[missing], white[:, missing] = 0.0, 0.0
        own = np.maximum(np.diag(R), 1e-12 * np.diag(H @ before @ H.T))
        np.fill_diagonal(white, np.where(missing, 1.0, own))
        for chain in (self.steps, self.samples):
            step = chain[-1]
            step.H, step.R, step.res, step.K = (
                H,
                white,
                mem[at[3] : at[4]].copy(),
                mem[at[1] : at[2]].reshape(n, a).copy(),
            )
            step.G = naive.attitude_reset(mem[at[4]], n)
            if dims[7] > 0:
                step.G = naive.deviation_turn(step.K[:, 0], step.res[0], dims[7]) @ step.G

    def rows(self):
        """Per track row: how many steps came before it, and the forward covariance."""
        sizes = [self.tape.layouts[number].size for number in self.tape.row_layouts]
        rows = []
        for i, (count, n) in enumerate(zip(self.tape.row_records, sizes, strict=True)):
            P = np.zeros((n, n))
            P[triangle(n)] = self.tape.rows[i][8 + n :]
            rows.append((count, P + np.tril(P, -1).T))
        return rows

    def smoothed(self):
        result = {}
        smooth_rows(
            self.tape,
            lambda begin, states, means, covs, _: result.update(
                zip(self.tape.row_records[begin : begin + len(states)], zip(means, covs, strict=True), strict=True)
            ),
        )
        return result


class Unknowns:
    """A whole run as one linear function of its unknowns: the error at the start and the noises of all steps.

    Singular P0 and Q need no inverse that way. Extended precision, because readings without white noise make the
    covariance of the residuals nearly singular. The number of states may change from step to step. After step k only
    the unknowns up to its own noise have come in: matrices are as wide as that, as multiplying by zeros is most of the
    work otherwise.

    Attributes
    ----------
    kept : dict of int to (A, c, P)
        After the `wanted` steps: the present error is A unknowns + c, P its covariance as long as nothing is seen.
    """

    def __init__(self, steps, P0, wanted):
        wide = np.longdouble
        A, c, P = np.eye(len(P0), dtype=wide), np.zeros(len(P0), wide), np.asarray(P0, wide)
        self.prior, self.seen, self.kept = [P], [], {0: (A, c, P)}
        for k, step in enumerate(steps, 1):
            A = np.hstack([step.Phi @ A, np.eye(len(step.Phi), dtype=wide)])
            c, P = step.Phi @ c, step.Phi @ P @ step.Phi.T + step.Q
            self.prior.append(np.asarray(step.Q, wide))
            if step.H is not None:
                self.seen.append((k, step.H @ A, step.res - step.H @ c, step.R))
                A, c, P = step.G @ A, step.G @ (c - step.K @ step.res), step.G @ P @ step.G.T
            if step.U is not None:
                A, P = np.hstack([A, np.eye(len(A), dtype=wide)]), P + step.U
                self.prior.append(np.asarray(step.U, wide))
            if k in wanted:
                self.kept[k] = A, c, P

    def posterior(self, wanted, upto=math.inf):
        """Mean and covariance of the error after the `wanted` steps, given the residuals of the first `upto` steps.

        One dense conditioning.
        """
        seen = [row for row in self.seen if row[0] <= upto]
        B = np.zeros((sum(len(gap) for _, _, gap, _ in seen), sum(map(len, self.prior))), np.longdouble)
        for at, (_, rows, _, _) in zip(np.cumsum([0, *(len(gap) for _, _, gap, _ in seen)]), seen, strict=False):
            B[at : at + len(rows), : rows.shape[1]] = rows
        ends = np.cumsum([len(M) for M in self.prior])
        weighted = np.vstack([M @ B[:, end - len(M) : end].T for end, M in zip(ends, self.prior, strict=True)])
        S = B @ weighted + block_diag(*(R for *_, R in seen))
        y, result = np.concatenate([gap for _, _, gap, _ in seen]), {}
        for k in wanted:
            A, c, P = self.kept[k]
            cross = A @ weighted[: A.shape[1]]
            solved = naive.cholesky_solve(S, np.column_stack([y, cross.T]))
            result[k] = (c + cross @ solved[:, 0]).astype(float), (P - cross @ solved[:, 1:]).astype(float)
        return result


def assert_same(actual, expected, scale, tolerance):
    """Means in units of the sd, covariances of both sds."""
    (mean, cov), (mean_expected, cov_expected) = actual, expected
    unit = np.where(scale > 0, scale, 1.0)
    np.testing.assert_allclose(mean / unit, mean_expected / unit, rtol=0, atol=tolerance)
    np.testing.assert_allclose(cov / np.outer(unit, unit), cov_expected / np.outer(unit, unit), rtol=0, atol=tolerance)


def start(**changes):
    given = {"latitude_deg": 35.0, "longitude_deg": 20.0, "heading_deg": 60.0, "velocity_n": (1.0, 1.0, 0.0)}
    return nf.Start(
        **(given | {"position_sd_m": 5.0, "velocity_sd_m_s": 0.3, "tilt_sd_deg": 2.0, "heading_sd_deg": 10.0} | changes)
    )


def inertial_vehicle(arma=True):
    """Several rates, every kind of block, scale and offset; ``arma=False``: each reading has white noise of its own."""
    shaped = nf.Arma(**ARMA, sd=0.4 * DEG) if arma else nf.Arma(**ARMA, sd=0.4 * DEG) + nf.White(sd=0.2 * DEG)
    return nf.Vehicle(
        imu=nf.Imu(
            rate_hz=20.0,
            gyro=nf.White(density=1e-3) + nf.RandomWalk(density=1e-4, start_sd=1e-3),
            accel=(
                nf.White(density=1e-2),
                nf.GaussMarkov(sd=0.05, tau_s=3.0, order=2) + nf.White(density=1e-2),
                nf.RandomWalk(density=1e-3, start_sd=0.02),
            ),
        ),
        sensors={
            "compass": nf.Heading(rate_hz=5.0, error=shaped, bias_sd_rad=0.02, deviation_sd_rad=(0.03, 0.01)),
            "dvl": nf.BodyVelocity(
                rate_hz=4.0,
                error=nf.GaussMarkov(sd=0.1, tau_s=2.0, order=2) + nf.White(sd=0.05),
                lever_arm_b_m=(0.5, 0.1, 0.2),
                scale_sd=0.01,
                misalignment_sd_rad=0.02,
            ),
            "depth": nf.Depth(
                rate_hz=1.0,
                error=nf.RandomWalk(density=0.1, start_sd=0.5) + nf.White(sd=0.1),
                offset_sd_m=0.5,
                lever_arm_b_m=(0.5, 0, 0),
            ),
            "gps": nf.Position(
                rate_hz=1.0,
                error=nf.GaussMarkov(sd=2.0, tau_s=20.0) + nf.White(sd=0.3),
                lever_arm_b_m=(-1.0, 0.2, -0.5),
            ),
        },
    )


def iron_vehicle(arma=True):
    """A magnetometer whose iron is not known, in place of the compass."""
    plain = inertial_vehicle(arma)
    compass = replace(plain.sensors["compass"], magnetometer=True, hard_iron_sd=2.0, soft_iron_sd=0.05)
    return nf.Vehicle(plain.drive, {**plain.sensors, "compass": replace(compass, declination_rad=0.1)})


def water_vehicle(arma=True, white=False):
    """The velocity is that through water whose current wanders within seconds; ``white=True``: only it ticks."""
    plain = inertial_vehicle(arma)
    error = nf.White(sd=0.05) if white else plain.sensors["dvl"].error
    calibration = {} if white else {"scale_sd": 0.01, "misalignment_sd_rad": 0.02}
    water = nf.WaterVelocity(
        rate_hz=4.0,
        error=error,
        lever_arm_b_m=(0.5, 0.1, 0.2),
        current_sd_m_s=0.4,
        current_tau_s=3.0,
        mounting_rad=(0.1, 0.0, 0.7),
        **calibration,
    )
    return nf.Vehicle(plain.drive, {**plain.sensors, "dvl": water})


def beams_vehicle(arma=True):
    """The velocity is that of four beams, over ground and through water; scale and misalignment serve both."""
    plain = inertial_vehicle(arma)
    beams = nf.DvlBeams(
        rate_hz=4.0,
        error=plain.sensors["dvl"].error,
        lever_arm_b_m=(0.5, 0.1, 0.2),
        mounting_rad=(0.1, 0.0, 0.7),
        scale_sd=0.01,
        misalignment_sd_rad=0.02,
        current_sd_m_s=0.4,
        current_tau_s=3.0,
        water_error=nf.GaussMarkov(sd=0.1, tau_s=1.0) + nf.White(sd=0.05),
    )
    return nf.Vehicle(plain.drive, {**plain.sensors, "dvl": beams})


def ranging_vehicle(arma=True):
    """Ranges to two beacons of uncertain place, with scale and offsets, in place of fixes."""
    plain = inertial_vehicle(arma)
    ranges = nf.Range(
        rate_hz=2.0,
        beacons=((35.0003, 20.0004, -30.0), (35.0002, 19.9996, -30.0)),
        error=nf.GaussMarkov(sd=1.0, tau_s=3.0) + nf.White(sd=0.5),
        lever_arm_b_m=(0.5, 0.1, 0.2),
        beacon_sd_m=(2.0, 2.0, 1.0),
        scale_sd=0.01,
        offset_sd_m=0.5,
    )
    return nf.Vehicle(plain.drive, {**plain.sensors, "gps": ranges})


def usbl_vehicle(arma=True):
    """A ship hears the vehicle, with errors of hers, in place of fixes."""
    plain = inertial_vehicle(arma)
    angle = nf.GaussMarkov(sd=0.05, tau_s=3.0) + nf.White(sd=0.02)
    usbl = nf.Usbl(
        rate_hz=2.0,
        error=(nf.White(sd=0.5), angle, angle),
        lever_arm_b_m=(0.5, 0.1, 0.2),
        transceiver_mounting_rad=(0.1, 0.0, 0.7),
        misalignment_sd_rad=0.02,
        scale_sd=0.01,
        ship_sd_m=(1.0, 1.0, 0.5),
        ship_tau_s=3.0,
    )
    return nf.Vehicle(plain.drive, {**plain.sensors, "gps": usbl})


def ahrs_vehicle(arma=True):
    """An AHRS whose mounting is uncertain in place of the compass."""
    plain = inertial_vehicle(arma)
    slow = plain.sensors["compass"].error
    ahrs = nf.Attitude(
        rate_hz=5.0,
        error=(nf.GaussMarkov(sd=0.05, tau_s=3.0) + nf.White(sd=0.01), nf.White(sd=0.02), slow),
        mounting_rad=(0.1, -0.2, 0.7),
        misalignment_sd_rad=0.02,
    )
    return nf.Vehicle(plain.drive, {**plain.sensors, "compass": ahrs})


def wheeled_vehicle(arma=True):
    """Wheels that cannot slip, a receiver's course and a bottom that wanders, in place of DVL, depth and compass."""
    plain = inertial_vehicle(arma)
    wheels = nf.Odometer(
        rate_hz=4.0,
        error=(nf.GaussMarkov(sd=0.1, tau_s=2.0) + nf.White(sd=0.02), nf.White(sd=0.05), nf.White(sd=0.1)),
        lever_arm_b_m=(-0.5, 0.1, 0.2),
        scale_sd=0.02,
        misalignment_sd_rad=0.02,
    )
    course = nf.Course(rate_hz=1.0, error=nf.GaussMarkov(sd=0.1, tau_s=2.0), lever_arm_b_m=(0.5, 0.1, 0.2))
    bottom = nf.Altitude(rate_hz=5.0, lever_arm_b_m=(0.5, 0.1, 0.2), bottom_sd_m=0.5, bottom_tau_s=2.0)
    return nf.Vehicle(plain.drive, {**plain.sensors, "dvl": wheels, "depth": course, "compass": bottom})


def uncalibrated(build):
    """A vehicle that knows neither the clocks of its sensors nor exactly where they are, nor the scale of any axis."""
    each = {"scale_sd": (0.02, 0.03, 0.01), "misalignment_sd_rad": (0.01, 0.02, 0.03)}

    def built(arma=True):
        vehicle = build(arma)
        sensors = {
            name: replace(
                sensor,
                time_offset_sd_s=0.3,
                lever_arm_sd_m=(0.2, 0.1, 0.0) if sensor.has_lever_arm else (0.0,) * 3,
                **(each if isinstance(sensor, nf.BodyVelocity) else {}),
            )
            for name, sensor in vehicle.sensors.items()
        }
        drive = vehicle.drive
        if drive.inertial:
            drive = replace(
                drive,
                gyro_scale_sd=0.02,
                gyro_misalignment_sd_rad=0.01,
                accel_scale_sd=(0.01, 0.02, 0.003),
                accel_misalignment_sd_rad=0.01,
            )
        else:
            velocity = replace(drive.velocity, time_offset_sd_s=0.3, lever_arm_sd_m=(0.3, 0.2, 0.1), **each)
            attitude = replace(drive.attitude, time_offset_sd_s=0.2)
            drive = replace(drive, velocity=velocity, attitude=attitude)
        return replace(vehicle, drive=drive, sensors=sensors)

    return built


def resting_vehicle(arma=True):
    """What the gyros read in every quarter of a second is taken for that of a vehicle at rest."""
    plain = inertial_vehicle(arma)
    limits = {"gyro_sd_max": 1e3, "force_sd_max": 1e3, "gyro_mean_max": 1e3}
    resting = nf.ZeroRate(rate_hz=4.0, error=nf.GaussMarkov(sd=0.1, tau_s=1.0) + nf.White(sd=0.05), **limits)
    drive = replace(plain.drive, gyro_scale_sd=0.02)
    return nf.Vehicle(drive, {"turning": resting, "compass": plain.sensors["compass"], "gps": plain.sensors["gps"]})


def reckoning_vehicle(arma=True):
    shaped = nf.Arma(**ARMA, sd=0.8 * DEG) if arma else nf.GaussMarkov(sd=2.0 * DEG, tau_s=5.0) + nf.White(sd=1.0 * DEG)
    return nf.Vehicle(
        nf.DeadReckoning(
            rate_hz=4.0,
            attitude=nf.Heading(rate_hz=4.0, error=shaped, bias_sd_rad=0.05, deviation_sd_rad=(0.03, 0.01)),
            velocity=nf.BodyVelocity(
                rate_hz=4.0,
                error=nf.White(sd=0.05),
                lever_arm_b_m=(0.5, 0.1, 0.2),
                scale_sd=0.02,
                misalignment_sd_rad=0.01,
            ),
            tilt=nf.GaussMarkov(sd=0.5 * DEG, tau_s=5.0) + nf.White(sd=0.0 if arma else 0.2 * DEG),
        ),
        sensors={
            "depth": nf.Depth(rate_hz=1.0, error=nf.White(sd=0.1)),
            "gps": nf.Position(rate_hz=1.0, error=nf.Arma(**ARMA, sd=0.2)),
        },
    )


def drifting_vehicle(arma=True):
    """Dead reckoning through water whose current wanders within seconds."""
    plain = reckoning_vehicle(arma)
    log = nf.WaterVelocity(
        rate_hz=4.0,
        error=nf.White(sd=0.05),
        lever_arm_b_m=(0.5, 0.1, 0.2),
        scale_sd=0.02,
        current_sd_m_s=0.4,
        current_tau_s=3.0,
    )
    return replace(plain, drive=replace(plain.drive, velocity=log))


def open_gates(nav):
    for name in nav.vehicle.sensors:
        nav.filter.channels[name].limits[1:] = 1e4


def drive_through(nav, seconds, seed, readings=("compass", "dvl", "depth", "gps"), changes=()):
    """Feed plausible readings at several rates, off the drive's clock, with missing ones and components and an outlier.

    Gates are wide open but for the outlier: exactness does not need plausible readings. `changes`: (time, sensor, error
    model) to adopt.
    """
    rng, vehicle, begin, changes = np.random.default_rng(seed), nav.vehicle, nav.start.state, list(changes)
    open_gates(nav)
    rate = vehicle.drive.rate_hz
    events = [(k / rate, "drive") for k in range(1, int(seconds * rate) + 1)]
    for name, offset in zip(readings, (0.013, 0.03, 0.0, 0.021), strict=False):
        if name in vehicle.sensors:
            sensor = vehicle.sensors[name]
            events += [
                (k / sensor.rate_hz + offset, name) for k in range(int(seconds * sensor.rate_hz)) if rng.random() > 0.2
            ]
    for time_s, name in sorted(events):
        while changes and changes[0][0] <= time_s:
            nav.adopt(*changes.pop(0)[1:])
            open_gates(nav)
        turn = 0.2 * time_s
        if name == "drive":
            if isinstance(vehicle.drive, nf.Imu):
                nav.step(time_s, [0.01, 0.0, 0.2], [0.1, 0.3, -9.8])
            else:
                lost = rng.random() < 0.15
                nav.step(
                    time_s,
                    [0.02, 0.1, 1.0 + turn + 0.02 * rng.normal()],
                    [np.nan] * 3 if lost else 1.4 + 0.05 * rng.normal(size=3),
                )
            continue
        heading = 1.0 + turn
        kind = LIKE.get(type(vehicle.sensors[name]), name)
        kind = "field" if getattr(vehicle.sensors[name], "magnetometer", False) else kind
        outlier = kind == "gps" and 2.0 < time_s < 3.0
        value = {
            "compass": lambda heading=heading: [heading + 0.1 * rng.normal()],
            "field": lambda heading=heading: (
                np.array([20.0 * np.cos(heading), -20.0 * np.sin(heading), 40.0]) + rng.normal(size=3)
            ),
            "range": lambda: [53.0 + 2.0 * rng.normal(), float(rng.integers(2))],
            "usbl": lambda: [
                50.0 + rng.normal(),
                0.1 + 0.1 * rng.normal(),
                np.nan if rng.random() < 0.3 else 0.1 * rng.normal(),
                *(begin.latitude - 4.8e-6, begin.longitude - 6.2e-6, 0.0, 0.05, 0.0, 0.1),
            ],
            "ahrs": lambda heading=heading: [0.2, np.nan if rng.random() < 0.3 else -0.1, heading + 0.1 * rng.normal()],
            "wheels": lambda: [1.4 + 0.1 * rng.normal()],
            "altitude": lambda: [100.0 + 0.3 * rng.normal()],
            "course": lambda heading=heading: [1.4 + 0.1 * rng.normal(), heading],
            "beams": lambda: np.where(rng.random(8) < 0.3, np.nan, 0.5 + 0.2 * rng.normal(size=8)),
            "dvl": lambda: [1.4, 0.1 * rng.normal(), np.nan if rng.random() < 0.3 else 0.1 * rng.normal()],
            "depth": lambda: [1.0 + 0.3 * rng.normal()],
            "gps": lambda time_s=time_s, outlier=outlier: [
                begin.latitude + (time_s + 2.0 * rng.normal() + 1000.0 * outlier) / 6.4e6,
                begin.longitude + (time_s + 2.0 * rng.normal()) / 5.2e6,
                np.nan if rng.random() < 0.3 else 3.0 * rng.normal(),
            ],
        }[kind]()
        outcome = nav.correct(name, time_s, value)
        due = "waiting" if nav.vehicle.sensors[name].lead_s else "rejected" if outlier else "used"
        assert outcome.status == due, (name, time_s, outcome)
    nav.finish()
