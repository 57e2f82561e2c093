"""Estimate how other joints bend the sheaths from logs with the columns q_j.NAME.

    x_i = mu (Theta_0 + sum over joints of g_ij q_j)          (1; i: tendon a or b)
    T_p = T_p0 + k (mean of Theta_a and Theta_b - Theta_0)    (N; k = dT_p/dTheta by (3.52) and (3.56))

Friction torque and slope of the transmission depend on x and T_p. One least-squares fit of the joint torque therefore
finds x, T_p0, all gains g_ij and k at once (Gauss-Newton on the instrumented normal equations of `regression`). The fit
makes no assumption about the motion: joints may move alone or together. A parameter that the motion does not determine
has a wide interval. Without a joint torque sensor the elongation is fitted instead, with the stiffness in place of the
gain of tau_M.

mu and Theta_0 enter only as x = mu Theta_0. The gains are therefore relative to the file's Theta_0, which is kept. The
stiffness and lever in the file determine k. This value enters as an observation with the file's uncertainty, in
`tsa tune` with that of the measured stiffness. The torques separate k and the gains poorly: in 60 s with joints that
make three oscillations of 0.5 rad in 14 s, an error of k of 9 % comes with one of the gains of 5 %.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tsa_ctrl.errors import UsageError
from tsa_ctrl.identify.calibrate.prepared import PreparedLog, admit, instrument_lag, offsets, stack
from tsa_ctrl.identify.calibrate.regression import Estimate, Prior, block_labels, solve
from tsa_ctrl.identify.dataset import Dataset
from tsa_ctrl.identify.motion import inseparable, tied_joints
from tsa_ctrl.identify.quantity import Quantity
from tsa_ctrl.model.parameters import TendonSheath
from tsa_ctrl.model.predict import predict, stretch
from tsa_ctrl.model.routing import MOST_GAIN, Route, Routing
from tsa_ctrl.model.signals import Signals
from tsa_ctrl.signals import JOINT_ANGLE

FloatArray = NDArray[np.float64]

MOVED = 0.05  # rad, standard deviation of a joint's angle below which its gain is not estimated
ITERATIONS = 10  # most Gauss-Newton steps; simulated rigs need 2 to 7
LARGEST_STEP = 0.3  # largest step of a logarithm, and of a gain in rad/rad: from a wrong file, the first is too long
SMALLEST_STEP = 1e-5  # smaller steps end the iteration: files have fewer digits
SETTLED = 0.02  # smaller steps do not update the instruments, which need not be exact
DERIVATIVE = 1e-4  # step of numerical derivatives: its errors are far below an interval
NEGLIGIBLE = 0.01  # share of Theta_0: a joint outside [routing] that changes the wrap angle by less does not bend it
PATHS = 0.02  # 1, deviation of a difference found from path lengths: friction changes the elongation of both tendons
FAR = 2.0  # half widths of the interval of the torques, in which one of 20 true values is not
ORDERS = (2, 3)  # of the polynomial in a joint's angle that gains are compared with
CURVED = 0.7  # 1, error of that polynomial over the error of gains, below which a table is proposed
POINTS = 7  # of the proposed table
EXACT = 1e-3  # least standard deviation of a logarithm of the file: [uncertainty] may be 0
# Indices of the parameters: four logarithms, then two gains for each joint
X, T, GAIN, SLOPE, JOINTS = 0, 1, 2, 3, 4


@dataclass(frozen=True)
class RoutingFit:
    """Hold the result of `fit_routing`.

    Attributes:
        model: the model with the gains in its [routing], and with the corresponding x, T_p0 and dT_p/dTheta.
        gains: rad/rad of wrap angle, by "gain.JOINT", or by "gain_a.JOINT" and "gain_b.JOINT" where the tendons differ.
            They are total gains, not changes of the file's gains. A joint with a table has "change_of_table.JOINT".
        slope: dT_p/dTheta, N/rad.
        friction_angle, pretension: x (1) and T_p0 (N) at Theta_0.
        joints: names of the joints that bend a sheath.
        straight: names of logged joints that moved but bend no sheath.
        kept: names of joints whose gain or table in the file agrees with the logs.
        error: RMS error of the fit over the admitted samples, N*m, or m for the elongation.
    """

    model: TendonSheath
    gains: dict[str, Quantity]
    slope: Quantity
    friction_angle: Quantity
    pretension: Quantity
    joints: tuple[str, ...]
    straight: tuple[str, ...]
    kept: tuple[str, ...]
    error: float

    @property
    def quantities(self) -> dict[str, Quantity]:
        """Return the gains and dT_p/dTheta by their public names."""
        return {**self.gains, "pretension_per_wrap_angle": self.slope}

    @property
    def sentence(self) -> str:
        """Return a sentence on the joints that bend the sheaths and on those that do not."""
        words = []
        for name, gain in self.gains.items():
            kind, _, joint = name.partition(".")
            tendon = f" (tendon {kind[-1]})" if kind.endswith(("_a", "_b")) else ""
            words.append(f"{joint}{tendon} {gain}{' beyond its table' if kind.startswith('change') else ''}")
        others = f"; {', '.join(self.kept)} as in the file" if self.kept else ""
        others += f"; no effect of {', '.join(self.straight)}" if self.straight else ""
        return f"wrap angle by other joints: {', '.join(words)}{others}. Gains refer to [sheath] bending_angle"


def bent_by(log: PreparedLog, model: TendonSheath) -> PreparedLog:
    """Return the log with the wrap angles of the model's [routing]; unchanged without one or without the angles."""
    routing, joints = model.routing, log.signals.joints
    if routing is None or not set(routing.joints) <= joints.keys():
        return log
    a, b = routing.wrap_angles(joints)
    apart = None if routing.alike else 0.5 * (a - b)
    signals = dataclasses.replace(log.signals, theta=model.bending_angle + 0.5 * (a + b), theta_difference=apart)
    return dataclasses.replace(log, signals=signals)


def joint_columns(log: Dataset, model: TendonSheath) -> tuple[str, ...]:
    """Return the columns q_j.NAME from which `fit_routing` finds gains; none if the log has a measured wrap angle."""
    if _measures_theta(model, "theta" in log):
        return ()
    return tuple(name for name in log.columns if name.startswith(JOINT_ANGLE))


def _measures_theta(model: TendonSheath, has_theta: bool) -> bool:
    return has_theta and model.routing is None  # with a routing, the column theta is derived from it


def moving_joints(logs: Sequence[PreparedLog]) -> dict[str, float]:
    """Return the standard deviation (rad) of the angle of each moving joint, without the actuator's own joint.

    Only joints whose column q_j.NAME is in all logs count.
    """
    names = [name for name in logs[0].signals.joints if all(name in log.signals.joints for log in logs)]
    found = {}
    for name, angles in _angles(logs, names).items():
        own = [log.signals.q_j for log in logs]
        if all(q is not None for q in own):
            joint = stack([q for q in own if q is not None], list(logs))
            if float(np.max(np.abs(angles - joint))) < MOVED:
                continue
        if float(np.std(angles)) > MOVED:
            found[name] = float(np.std(angles))
    return found


def resting_joints(logs: Sequence[PreparedLog], model: TendonSheath) -> str:
    """Return a sentence on the joints that are in all logs but do not move; empty without such a joint."""
    moving = moving_joints(logs)
    words = []
    for name in logs[0].signals.joints:
        if name in moving or not all(name in log.signals.joints for log in logs):
            continue
        angle = _angles(logs, [name])[name]
        if float(np.std(angle)) <= MOVED:
            given = model.routing is not None and name in model.routing.joints
            rest = "[routing] of the file is used for it" if given else "the result holds with the joint at this angle"
            words.append(f"joint {name} rests at {np.mean(angle):.2g} rad in these logs and shows no gain: {rest}")
    return "; ".join(words)


def _angles(logs: Sequence[PreparedLog], names: Iterable[str]) -> dict[str, FloatArray]:
    """Return the angle (rad) of each joint in the admitted samples of all logs, (n,)."""
    return {name: stack([log.signals.joints[name] for log in logs], list(logs)) for name in names}


class _Problem:
    """Define the parameters of the fit, their priors, and the response to them.

    The parameters are ln x, ln T_p0, ln of the gain of tau_M, ln k, and the mean and half the difference of the two
    tendons' gains for each joint. The last ones are the zero of each log and, for the elongation, the error of the
    radii.
    """

    def __init__(
        self, logs: list[PreparedLog], model: TendonSheath, joints: tuple[str, ...], by_elongation: bool
    ) -> None:
        self.logs, self.model, self.joints = logs, model, joints
        self.by_elongation = by_elongation
        self.lag = instrument_lag(logs)
        self.zero = offsets(logs)
        if by_elongation:
            angles = [log.signals.q_j for log in logs]
            self.zero = [np.column_stack([own, q]) for own, q in zip(self.zero, angles, strict=True) if q is not None]
        self.labels = np.concatenate([log.labels[log.mask] for log in logs])
        self.size = JOINTS + 2 * len(joints)
        self.start = np.zeros(self.size + self.zero[0].shape[1])
        self.start[X], self.start[T] = math.log(model.friction_angle), math.log(model.pretension)
        self.start[SLOPE] = math.log(max(model.pretension_slope, 1e-9))
        shares = (model.friction_angle_uncertainty, model.pretension_uncertainty, model.axial_stiffness_uncertainty)
        self.precision = np.zeros(self.start.size)
        self.precision[[X, T, SLOPE]] = [1.0 / max(math.log1p(share) / 1.96, EXACT) ** 2 for share in shares]
        if by_elongation:
            self.precision[GAIN] = self.precision[SLOPE]  # here the gain is that of the stiffness

    def model_at(self, p: FloatArray) -> TendonSheath:
        """Return the model with these parameters."""
        model = self.model.recalibrated(math.exp(p[X]), math.exp(p[T]))
        lever = math.exp(p[SLOPE]) / model.tendon_stiffness
        return dataclasses.replace(model, contact_offset=max(0.0, lever - 0.5 * model.diameter))

    def gains_at(self, p: FloatArray) -> tuple[dict[str, float], dict[str, float]]:
        """Return the gains of tendons a and b by joint, in addition to the file's gains, rad/rad."""
        mean, half = p[JOINTS : self.size : 2], p[JOINTS + 1 : self.size : 2]
        a, b = mean + half, mean - half
        return dict(zip(self.joints, a.tolist(), strict=True)), dict(zip(self.joints, b.tolist(), strict=True))

    def response(
        self, log: PreparedLog, p: FloatArray, tau_m: FloatArray, more: float = 0.0, apart: float = 0.0
    ) -> FloatArray:
        """Return the joint torque (N*m), or the elongation (m), predicted with these parameters, (n,).

        `more`, `apart`: rad added to the mean and to half the difference of the two wrap angles.
        """
        signals, variant = log.signals, self.model_at(p)
        if log.tensioner:
            variant = variant.recalibrated(pretension=variant.pretension + log.tensioner)
        a, b = (_added(signals, gains) for gains in self.gains_at(p))
        theta = self.model.bending_angle if signals.theta is None else signals.theta
        half = 0.0 if signals.theta_difference is None else signals.theta_difference
        speed = np.maximum(np.abs(signals.omega_j), 1e-9)
        bent = dataclasses.replace(
            signals,
            tau_m=tau_m if self.by_elongation else tau_m * math.exp(p[GAIN]),
            omega_j=np.where(log.mask, log.admission.direction * speed, signals.omega_j),
            theta=theta + 0.5 * (a + b) + more,
            theta_difference=half + 0.5 * (a - b) + apart,
        )
        if self.by_elongation:
            return math.exp(-p[GAIN]) * stretch(variant, bent)
        return predict(variant, bent)

    def error(self, p: FloatArray) -> float:
        """Return the RMS error of the response with these parameters over the admitted samples, N*m or m."""
        errors = []
        for log, own in zip(self.logs, self.zero, strict=True):
            level = self.response(log, p, log.signals.tau_m) + own @ p[self.size :]
            errors.append((log.tau_j - level)[log.mask])
        return float(np.sqrt(np.mean(np.square(np.concatenate(errors)))))

    def derivatives(self, log: PreparedLog, p: FloatArray, tau_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the response (n,) and its derivatives (n, `size`) with respect to the parameters."""
        level = self.response(log, p, tau_m)
        columns = []
        for place in range(JOINTS):
            up = p.copy()
            up[place] += DERIVATIVE
            columns.append((self.response(log, up, tau_m) - level) / DERIVATIVE)
        by_mean = (self.response(log, p, tau_m, more=DERIVATIVE) - level) / DERIVATIVE
        by_half = (self.response(log, p, tau_m, apart=DERIVATIVE) - level) / DERIVATIVE
        for name in self.joints:
            angle = log.signals.joints[name]
            columns += [by_mean * angle, by_half * angle]
        return level, np.column_stack(columns)

    def observe_paths(self, estimate: Estimate, free: list[int]) -> bool:
        """Add the differences of gains that path lengths show as observations; return False if none is added.

        The torques determine the products of mu and the gains much better than the gains. A difference that is far
        outside the interval of the torques is not added. It has another cause, such as a creeping tendon.
        """
        shown = {} if self.by_elongation else _differences(self.logs, self.model, self.joints)
        for joint, (half, deviation) in shown.items():
            place = JOINTS + 1 + 2 * self.joints.index(joint)
            if place in free:
                low, high = estimate.interval(free.index(place))
                if abs(half - 0.5 * (low + high)) < FAR * 0.5 * (high - low) + 2.0 * deviation:
                    self.start[place], self.precision[place] = half, deviation**-2.0
        return bool(np.any(self.precision[JOINTS : self.size]))

    def solve(self, fixed: set[int], start: FloatArray | None = None) -> tuple[FloatArray, Estimate, list[int]] | None:
        """Return all parameters, the estimate of the free ones, and the indices of the free ones; None if it fails.

        `fixed`: indices of the parameters that keep their start values.
        """
        p = (self.start if start is None else start).copy()
        p[sorted(fixed)] = self.start[sorted(fixed)]
        free = [place for place in range(p.size) if place not in fixed]
        logs = self.logs
        instruments, size = np.zeros(0), math.inf
        for _ in range(ITERATIONS):
            x, y = [], []
            for log, own in zip(logs, self.zero, strict=True):
                level, rows = self.derivatives(log, p, log.signals.tau_m)
                x.append(np.column_stack([rows, own])[log.mask][:, free])
                y.append((log.tau_j - level - own @ p[self.size :])[log.mask])
            if size > SETTLED:
                lag = [self.derivatives(log, p, log.instrument(self.lag))[1] for log in logs]
                pairs = zip(logs, lag, self.zero, strict=True)
                instruments = np.concatenate([np.column_stack([z, own])[log.mask][:, free] for log, z, own in pairs])
            prior = Prior((self.start - p)[free], self.precision[free])
            try:
                found = solve(np.concatenate(x), instruments, np.concatenate(y), self.labels, prior)
            except np.linalg.LinAlgError:
                return None
            step = np.clip(found.value, -LARGEST_STEP, LARGEST_STEP)
            p[free] += step
            p[JOINTS : self.size] = np.clip(p[JOINTS : self.size], -MOST_GAIN, MOST_GAIN)
            if not np.all(np.isfinite(p)):
                return None
            size = float(np.max(np.abs(step)))
            if size < SMALLEST_STEP:
                break
        return p, dataclasses.replace(found, value=p[free]), free


def _differences(
    logs: Sequence[PreparedLog], model: TendonSheath, joints: tuple[str, ...]
) -> dict[str, tuple[float, float]]:
    """Return half the difference of the tendons' gains by joint, beyond the file, and its standard deviation, rad/rad.

    Tendons with different routings have different path lengths, so that motor and joint differ by

        r_M q_M - r_J q_J = zero + (p + d/2) (Theta_a - Theta_b) / 2 + (elongation by the torques)          (m; (3.52))

    The result is empty without both angles.
    """
    rows, y = [], []
    for log in logs:
        s = log.signals
        if s.q_m is None or s.q_j is None or model.lever == 0.0:
            return {}
        given = 0.0 if s.theta_difference is None else s.theta_difference
        length = model.motor_pulley_radius * s.q_m - model.joint_pulley_radius * s.q_j
        y.append((length - model.lever * given)[log.mask])
        rows.append(np.column_stack([*(s.joints[name] for name in joints), s.tau_m, log.tau_j, s.q_j])[log.mask])
    ones = [np.tile(np.arange(len(logs)) == k, (len(part), 1)) for k, part in enumerate(rows)]
    x = np.column_stack([np.concatenate(rows), np.concatenate(ones)])
    try:
        found = solve(x, x, np.concatenate(y), np.concatenate([log.labels[log.mask] for log in logs]))
    except np.linalg.LinAlgError:
        return {}
    halves = {}
    for k, name in enumerate(joints):
        low, high = (end / model.lever for end in found.interval(k))
        half, deviation = 0.5 * (low + high), 0.25 * (high - low)
        halves[name] = half, math.hypot(deviation, PATHS * half)
    return halves


def of_elongation(logs: Sequence[Dataset], model: TendonSheath) -> list[PreparedLog]:
    """Return logs without a joint torque for `fit_routing`, with r_M q_M - r_J q_J (m) as the quantity to fit."""
    prepared = []
    for log, labels in zip(logs, block_labels([len(log) for log in logs]), strict=True):
        signals = log.completed_for(model).signals()
        length = model.motor_pulley_radius * log["q_m"] - model.joint_pulley_radius * log["q_j"]
        everything = np.ones(len(log), dtype=np.bool_)
        admission = admit(signals.t, signals.omega_j)
        prepared.append(PreparedLog(log.name, signals, length, None, admission, labels, 0.0, everything))
    return [log for log in prepared if log.mask.any()]


def fit_routing(
    logs: list[PreparedLog], model: TendonSheath, certified_gain: bool, by_elongation: bool = False
) -> RoutingFit | None:
    """Return the gains of all joints that move in the logs, with x, T_p0 and dT_p/dTheta.

    `by_elongation`: True for the logs of `of_elongation`. The result is None if no joint bends a sheath, and for logs
    with a measured wrap angle (column theta).

    Raises:
        UsageError: joints move in proportion, and bend a sheath otherwise than in the file.
    """
    moved = moving_joints(logs) if logs else {}
    tied = tied_joints(_angles(logs, moved))
    moved = {name: deviation for name, deviation in moved.items() if name not in tied}
    measured = any(_measures_theta(model, log.signals.theta is not None) for log in logs)
    if not moved or measured or model.bending_angle <= 0.0:
        return None
    problem = _Problem(logs, model, tuple(moved), by_elongation)
    fixed = {GAIN} if certified_gain and not by_elongation else set[int]()
    given = () if model.routing is None else model.routing.joints
    found = None
    halves = set(range(JOINTS + 1, problem.size, 2))
    while True:  # remove the gains that the logs do not determine, the least certain one first
        found = problem.solve(fixed, None if found is None else found[0])
        if found is None:
            return None
        p, estimate, free = found
        shares = {}
        for place in free:
            if JOINTS <= place < problem.size:
                low, high = estimate.interval(free.index(place))
                joint = problem.joints[(place - JOINTS) // 2]
                half = 0.5 * (high - low)
                shares[place] = abs(p[place]) / max(half, 1e-12)
                if joint not in given:  # the file's gain would count as exact and fix the scale of all others
                    reach = moved[joint] / model.bending_angle
                    shares[place] = min(shares[place], abs(p[place]) * reach / NEGLIGIBLE)
        # A joint whose tendons differ bends the sheath, so its mean gain is kept.
        removable = {place: share for place, share in shares.items() if place in halves or place + 1 in fixed}
        least = min(removable, key=lambda place: removable[place], default=None)
        if least is None or removable[least] > 1.0:
            break
        fixed.add(least)
    if problem.observe_paths(estimate, free):
        found = problem.solve(fixed, p)
        if found is None:
            return None
        p, estimate, free = found
    bending = tuple(name for k, name in enumerate(problem.joints) if JOINTS + 2 * k not in fixed)
    if not bending:
        return None
    if reason := inseparable(tied, bending):
        raise UsageError(f"calibrate: {reason}")
    return _result(problem, p, estimate, free, bending)


def _result(
    problem: _Problem, p: FloatArray, estimate: Estimate, free: list[int], bending: tuple[str, ...]
) -> RoutingFit:
    model = problem.model
    before = model.routing or Routing(Route({}, {}), Route({}, {}))
    a, b = ({name: float(f"{gains[name]:.4g}") for name in bending} for gains in problem.gains_at(p))
    routing = Routing(before.a.plus(a), before.b.plus(b))
    gains = {}
    for name in bending:
        mean = JOINTS + 2 * problem.joints.index(name)
        alike = routing.a.only(name) == routing.b.only(name)
        tendons = (("", routing.a, 0.0),) if alike else (("_a", routing.a, 1.0), ("_b", routing.b, -1.0))
        for suffix, route, sign in tendons:
            gradient = np.zeros(len(free))
            gradient[free.index(mean)] = 1.0
            if mean + 1 in free:
                gradient[free.index(mean + 1)] = sign
            low, high = estimate.interval_of(gradient)
            half, tabled = 0.5 * (high - low), name in route.tables
            value = (b if sign < 0.0 else a)[name] if tabled else route.gains[name]
            key = f"{'change_of_table' if tabled else 'gain'}{suffix}.{name}"
            gains[key] = Quantity(value, value - half, value + half, "rad/rad")
    logarithms = {}
    for place, unit in ((X, "1"), (T, "N"), (SLOPE, "N/rad")):
        low, high = estimate.interval(free.index(place))
        logarithms[place] = Quantity(math.exp(p[place]), math.exp(low), math.exp(high), unit)
    return RoutingFit(
        model=dataclasses.replace(problem.model_at(p), routing=routing),
        gains=gains,
        slope=logarithms[SLOPE],
        friction_angle=logarithms[X],
        pretension=logarithms[T],
        joints=bending,
        straight=tuple(name for name in problem.joints if name not in {*bending, *before.joints}),
        kept=tuple(name for name in problem.joints if name not in bending and name in before.joints),
        error=problem.error(p),
    )


def curved_routing(logs: list[PreparedLog], model: TendonSheath, routed: RoutingFit | None) -> str:
    """Return a sentence with a table for [routing] if the wrap angle is clearly not proportional to a joint's angle.

    The table is a polynomial of third order over the measured range. It is compared with equal gains of both tendons,
    and with `routed`, the result of `fit_routing`, which is None if the wrap angle has an extremum in the middle of the
    motion. The sentence is empty if either describes the logs nearly as well, and for a model with a table.
    """
    joints, given = tuple(moving_joints(logs) if logs else {}), model.routing
    tables = given is not None and (given.a.tables or given.b.tables)
    measured = any(_measures_theta(model, log.signals.theta is not None) for log in logs)
    if not joints or tables or measured or model.bending_angle <= 0.0 or tied_joints(_angles(logs, joints)):
        return ""
    terms = {name: (name, *(f"{name}^{order}" for order in ORDERS)) for name in joints}
    curved = []
    for log in logs:
        angles = {term: log.signals.joints[name] ** (k + 1) for name in joints for k, term in enumerate(terms[name])}
        signals = dataclasses.replace(log.signals, joints=angles, theta=None, theta_difference=None)
        curved.append(dataclasses.replace(log, signals=signals))
    model = dataclasses.replace(model, routing=None)
    problem = _Problem(curved, model, tuple(term for each in terms.values() for term in each), by_elongation=False)
    fixed = {GAIN, *range(JOINTS + 1, problem.size, 2)}
    powers = {JOINTS + 2 * k for k, term in enumerate(problem.joints) if term not in joints}
    found, line = problem.solve(fixed), problem.solve(fixed | powers)
    if found is None or line is None:
        return ""
    gains_error = min(problem.error(line[0]), math.inf if routed is None else routed.error)
    share = problem.error(found[0]) / gains_error
    if share > CURVED:
        return ""
    gains, _ = problem.gains_at(found[0])
    lines = {}
    for name in joints:
        angle = stack([log.signals.joints[name] for log in logs], logs)
        bent = np.polynomial.Polynomial([0.0, *(gains[term] for term in terms[name])])
        if float(np.std(bent(angle))) < NEGLIGIBLE * model.bending_angle:
            continue
        q = np.linspace(float(angle.min()), float(angle.max()), POINTS)
        points = ", ".join(f"[{a:.3g}, {b:.3g}]" for a, b in zip(q.tolist(), bent(q).tolist(), strict=True))
        lines[name] = f"table.{name} = [{points}]"
    if not lines:
        return ""
    return (
        f"the wrap angle is not proportional to the angle of {', '.join(lines)}: a curve leaves {100.0 * share:.0f} % "
        f"of the error of a line. Write {' and '.join(lines.values())} in [routing] instead of gains, and calibrate "
        "again"
    )


def _added(signals: Signals, gains: dict[str, float]) -> FloatArray:
    bent = np.zeros(signals.t.size)
    for name, gain in gains.items():
        bent += gain * signals.joints[name]
    return bent
