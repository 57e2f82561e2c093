# mypy: disallow-untyped-decorators=False
"""Simulate a pair of tendons in their sheaths, contact by contact; the functions are compiled and cached.

Each tendon is a chain of N + 1 springs and N contacts, with spring 0 at the motor. A contact holds within the capstan
limits,

    T_i e^-x_i <= T_{i+1} <= T_i e^x_i,     |T_i - T_{i+1}| <= g_i (T_i + T_{i+1}),  g_i = tanh(x_i / 2)

and slips by delta_i (positive to the motor) when it reaches a limit. A step moves the joint ends by -+dv and both motor
ends by -+du. du follows from T3 - T1 = tau_M/r_M, because the inputs are the motor torque and the joint angle. (With
both angles as inputs, tensions near a reversal would follow single counts of the motor encoder.) Newton's method finds
the set of slipping contacts, and each iteration solves one tridiagonal system. The state consists of the tensions only.
They contain partial reversals and their return points.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from tsa_ctrl.model.functions import Array
from tsa_ctrl.system.compiling import announce

announce()

STIFFNESS = 0  # N/m of spring i
TENSION = 1  # N of spring i
SHARE = 2  # 1, share of the total bending at contact i
GRIP = 3  # 1, g_i of contact i
MODE = 4  # of contact i: 0 holds, 1 slips to the motor, -1 slips to the joint
UPPER, SLIP, BY_MOTOR, NEW = 5, 6, 7, 8  # of the elimination: delta = SLIP + BY_MOTOR du; NEW: trial tensions
HELD = 9  # two rows: N of spring i, the other pairs minus the first when the joint end came to rest
ROWS = 11
ROUNDS = 60  # iterations of Newton's method: one or two are usual, at most one per contact that a step passes
PIECES = 8  # number of parts of a step for which no set of modes was found
_FORCE = 1e-7  # N above the capstan limit at which a contact still holds, because of rounding
_BACK = 1e-13  # m of slip against the friction that counts as rounding


@njit(cache=True, error_model="numpy")
def grip(pair: Array, x: float) -> None:
    """Set the capstan limits of both tendons, `pair` (2, ROWS, N + 1), for the friction angle x."""
    for i in range(pair.shape[2] - 1):
        g = math.tanh(0.5 * x * pair[0, SHARE, i])
        pair[0, GRIP, i] = g
        pair[1, GRIP, i] = g


@njit(cache=True, error_model="numpy")
def _solve(c: Array, joint: float) -> None:
    """Compute the slip of all contacts for the present modes by the Thomas algorithm.

    `joint`: m, motion of the joint end.
    """
    n = c.shape[1] - 1
    upper = slip = by_motor = 0.0
    for i in range(n):
        mode = c[MODE, i]
        if mode == 0.0:
            upper = slip = by_motor = 0.0
        else:
            g = mode * c[GRIP, i]
            a, b = (1.0 - g) * c[STIFFNESS, i], (1.0 + g) * c[STIFFNESS, i + 1]
            right = (1.0 + g) * c[TENSION, i + 1] - (1.0 - g) * c[TENSION, i]
            before, after, motor = (0.0, b, -a) if i == 0 else (a, b, 0.0)
            if i == n - 1:
                right -= b * joint
                after = 0.0
            pivot = 1.0 / (-(a + b) - before * upper)
            slip = (right - before * slip) * pivot
            by_motor = (motor - before * by_motor) * pivot
            upper = after * pivot
        c[UPPER, i], c[SLIP, i], c[BY_MOTOR, i] = upper, slip, by_motor
    slip = by_motor = 0.0
    for i in range(n - 1, -1, -1):
        slip = c[SLIP, i] - c[UPPER, i] * slip
        by_motor = c[BY_MOTOR, i] - c[UPPER, i] * by_motor
        c[SLIP, i], c[BY_MOTOR, i] = slip, by_motor


@njit(cache=True, error_model="numpy")
def _sort(c: Array, motor: float, joint: float) -> bool:
    """Compute the trial tensions and correct the modes; return True if no mode had to change.

    `motor`, `joint`: m, motion of the two ends.
    """
    n = c.shape[1] - 1
    left = motor
    for i in range(n + 1):
        right = c[SLIP, i] + c[BY_MOTOR, i] * motor if i < n else joint
        c[NEW, i] = c[TENSION, i] + c[STIFFNESS, i] * (left - right)
        left = right
    settled = True
    for i in range(n):
        difference = c[NEW, i] - c[NEW, i + 1]
        mode = c[MODE, i]
        if mode == 0.0:
            if abs(difference) > c[GRIP, i] * (c[NEW, i] + c[NEW, i + 1]) + _FORCE:
                c[MODE, i] = 1.0 if difference > 0.0 else -1.0
                settled = False
        elif mode * (c[SLIP, i] + c[BY_MOTOR, i] * motor) < -_BACK:
            c[MODE, i] = 0.0
            settled = False
    return settled


@njit(cache=True, error_model="numpy")
def _try(pair: Array, difference: float, joint: float) -> tuple[float, bool]:
    """Solve for the modes of both tendons by Newton's method and apply the new tensions if the modes converge.

    Returns the motion of the motor pulley (m) and True, or 0 and False without convergence.
    """
    a, b = pair[0], pair[1]
    for _ in range(ROUNDS):
        _solve(a, -joint)
        _solve(b, joint)
        ka, kb = a[STIFFNESS, 0], b[STIFFNESS, 0]
        rest = b[TENSION, 0] - kb * b[SLIP, 0] - a[TENSION, 0] + ka * a[SLIP, 0]
        motor = (difference - rest) / (kb * (1.0 - b[BY_MOTOR, 0]) + ka * (1.0 - a[BY_MOTOR, 0]))
        settled_a, settled_b = _sort(a, -motor, -joint), _sort(b, motor, joint)
        if settled_a and settled_b:
            for i in range(a.shape[1]):
                a[TENSION, i], b[TENSION, i] = a[NEW, i], b[NEW, i]
            return motor, True
    return 0.0, False


@njit(cache=True, error_model="numpy")
def move(pair: Array, difference: float, joint: float) -> tuple[float, bool]:
    """Advance tendons a and b to T3 - T1 = `difference` (N) while the joint pulley moves by `joint` (m).

    Returns the motion of the motor pulley (m), and True if the set of slipping contacts was found.
    """
    motor, settled = _try(pair, difference, joint)
    if settled:
        return motor, True
    start = pair[1, TENSION, 0] - pair[0, TENSION, 0]
    motor = 0.0
    for piece in range(PIECES):
        for i in range(pair.shape[2] - 1):
            pair[0, MODE, i] = pair[1, MODE, i] = 0.0
        way, settled = _try(pair, start + (piece + 1) / PIECES * (difference - start), joint / PIECES)
        motor += way
        if not settled:
            return motor, False
    return motor, True


@njit(cache=True, error_model="numpy")
def follow(pair: Array, difference: Array, joint: Array) -> tuple[Array, Array, Array]:
    """Simulate a whole log from T3 - T1 (N) and the motion of the joint pulley in each step (m), (n,) each.

    Returns (n,) each: the elongation since the start (m), T4 - T2 (N; nan if the modes were not found), and 0 until all
    contacts of both tendons slip for the first time, then 1.
    """
    n = difference.size
    stretch, end, slid = np.zeros(n), np.zeros(n), np.zeros(n)
    last = pair.shape[2] - 1
    way = 0.0
    known = False
    for k in range(n):
        moved, settled = move(pair, difference[k], joint[k])
        way += moved - joint[k]
        all_slide = settled
        for i in range(last):
            all_slide = all_slide and pair[0, MODE, i] != 0.0 and pair[1, MODE, i] != 0.0
        known = known or all_slide
        stretch[k] = way
        end[k] = pair[1, TENSION, last] - pair[0, TENSION, last] if settled else math.nan
        slid[k] = 1.0 if known else 0.0
    return stretch, end, slid


# State of `observe` between two calls, an array of floats.
ANGLE = 0  # 1, present friction angle x of the tendons
ZERO = 1  # m, measured elongation of tendons without elongation, relative to the first measurement
FAST = 2  # 1, temporary friction in addition to x
STIFF = 3  # 1, stiffness over the model's value
SLID = 4  # 1 once both tendons have slid far enough along their whole length to be independent of their initial state
INNOVATION = 5  # m
REST = 6  # 1, weight of the tensions at the time at which the joint end came to rest; 0 again once all contacts slide
KNOWN = 7  # 1, share of the held tensions that counts as known
HELD_V = 8  # N^2, variance of T4 - T2 when the joint end came to rest
JOINT_WAY = 9  # m, motion of the joint pulley so far
WAY = 10  # three entries: m, motion of the motor pulley so far, by each pair
GAIN_S, GAIN_T = 13, 15  # two each: sensitivities of elongation (m) and T4 - T2 (N) to ln x and ln STIFF
HELD_S, HELD_T = 17, 19  # the same sensitivities when the joint end of both tendons came to rest
SLIDING = 21  # m, motion of motor and joint while both tendons slid along their whole length in one direction
SENSE = 22  # -1 or 1, that direction; 0 before the first such motion
TURNED = 23  # 1 if the previous such motion had the opposite direction
COVARIANCE = 24  # first of the 16 entries of the covariance, (4, 4)
STATES = 4
X, K, F, Z = 0, 1, 2, 3  # ln x, ln STIFF, FAST, ZERO (m)
MEMORY = COVARIANCE + STATES * STATES
# Constants of the filter.
LOW, HIGH = 0, 1  # of x
MOST_ZERO = 2  # m, largest size of the zero
MOST_STIFF = 3  # upper bound of STIFF; the lower bound is its inverse
PRIOR = 4  # four entries: initial variances of the states, and their upper limits afterwards
WALK = 8  # four entries: variance that a state gains in a step
KEEP_F = 12  # share of FAST that remains after a step
NOISE = 13  # m^2, variance of a measured elongation
LEAST = 14  # N, tension below which a tendon is slack
SETTLED = 15  # m of SLIDING after which the initial state has no effect; a quarter of it suffices after a reversal
SETTINGS = 16
PAIRS = 3  # nominal, with other friction, with other stiffness
MORE = (-0.05, 0.05)  # 1, change of x and of the stiffness; with less x, that pair slips before the nominal one does
_OUTLIER = 5.0  # standard deviations to which an innovation is limited
_STEP = 0.05  # 1, most change of ln x and ln STIFF in a cycle, because the tensions must follow
OK, UNSETTLED, SLACK = 0, 1, 2


@njit(cache=True, error_model="numpy")
def covariance(memory: Array) -> Array:
    """Return the covariance (4, 4) as a view of the memory."""
    found: Array = memory[COVARIANCE : COVARIANCE + STATES * STATES].reshape((STATES, STATES))
    return found


@njit(cache=True, error_model="numpy")
def _rest(pairs: Array, w: Array, keep: float, sure: float, way: float, settled: float) -> None:
    """Update SLID, and record the sensitivities and tensions at which the joint end comes to rest.

    Tensions that were determined while all contacts slid no longer depend on x and stiffness once the joint end rests.
    REST is the weight of this record and depends on how well x was known. KNOWN follows REST slowly.

    Args:
        keep: share of KNOWN that remains after a step.
        sure: variance of ln x at which the weight is one half.
        way: m, motion of motor and joint in this step.
        settled: see SETTLED.
    """
    n = pairs.shape[3] - 1
    slides = True
    for i in range(n):
        slides = slides and pairs[0, 0, MODE, i] != 0.0 and pairs[0, 1, MODE, i] != 0.0
    if slides:
        sense = pairs[0, 1, MODE, 0]
        if sense != w[SENSE]:
            w[TURNED] = 1.0 if w[SENSE] != 0.0 else 0.0
            w[SENSE], w[SLIDING] = sense, 0.0
        w[SLIDING] += way
        if w[SLIDING] > (0.25 if w[TURNED] else 1.0) * settled:
            w[SLID] = 1.0
        w[REST] = 0.0
    elif w[REST] == 0.0 and pairs[0, 0, MODE, n - 1] == 0.0 and pairs[0, 1, MODE, n - 1] == 0.0:
        w[REST] = sure / (sure + covariance(w)[X, X])
        w[HELD_V] = _variance(w)
        for which in range(2):
            w[HELD_S + which], w[HELD_T + which] = w[GAIN_S + which], w[GAIN_T + which]
            for tendon in range(2):
                for i in range(n + 1):
                    change = pairs[1 + which, tendon, TENSION, i] - pairs[0, tendon, TENSION, i]
                    pairs[0, tendon, HELD + which, i] = change
    w[KNOWN] = keep * w[KNOWN] + (1.0 - keep) * w[REST] * w[SLID]


@njit(cache=True, error_model="numpy")
def _variance(w: Array) -> float:
    """Return the variance of T4 - T2 (N^2) that follows from the variances of friction and stiffness."""
    p, by_x, by_k = covariance(w), w[GAIN_T], w[GAIN_T + 1]
    found = by_x * by_x * (p[X, X] + 2.0 * p[X, F] + p[F, F]) + 2.0 * by_x * by_k * (p[X, K] + p[F, K])
    return float(found + by_k * by_k * p[K, K])


@njit(cache=True, error_model="numpy")
def _take_over(pairs: Array, w: Array, which: int, change: float) -> None:
    """Change the tensions to those that would exist if x (`which` 0) or the stiffness (1) had always been different.

    The part of the tensions that is known since the joint end came to rest stays.

    Args:
        change: of the logarithm of x or of the stiffness.
    """
    share = change / MORE[which]
    for tendon in range(2):
        for i in range(pairs.shape[3]):
            difference = pairs[1 + which, tendon, TENSION, i] - pairs[0, tendon, TENSION, i]
            more = share * (difference - w[KNOWN] * pairs[0, tendon, HELD + which, i])
            for number in range(PAIRS):
                pairs[number, tendon, TENSION, i] += more
    for number in range(PAIRS):
        w[WAY + number] += change * w[GAIN_S + which]


@njit(cache=True, error_model="numpy")
def spread(pairs: Array, x: float, stiffer: float) -> None:
    """Set the friction angles of all pairs for x, and multiply their stiffness by `stiffer`."""
    for number in range(PAIRS):
        grip(pairs[number], (1.0 + MORE[0]) * x if number == 1 else x)
        for tendon in range(2):
            for i in range(pairs.shape[3]):
                pairs[number, tendon, STIFFNESS, i] *= stiffer


@njit(cache=True, error_model="numpy")
def observe(
    pairs: Array, memory: Array, settings: Array, difference: float, stretch: float, joint: float, doubt: float = 0.0
) -> tuple[int, float, float, float, float, float, float, bool]:
    """Advance all pairs, which differ by `MORE`, by a cycle: predict the elongation, and correct it by the measurement.

    The prediction is not corrected before SLID, because the state of the tendons is unknown.

    Args:
        pairs: shape (3, 2, ROWS, N + 1).
        memory: state of the filter, shape (MEMORY,).
        settings: constants of the filter, shape (SETTINGS,).
        difference: T3 - T1, N.
        stretch: measured elongation s, m.
        joint: motion of the joint pulley since the last cycle, m.
        doubt: variance of the prediction in addition to NOISE, m^2.

    Returns:
        A code, T4 - T2 (N), its standard deviation by the tendons (N), the tensions of tendon b at motor and joint (N),
        the innovation (m), STIFF, and True if SLID is 1.
    """
    n, w = pairs.shape[3] - 1, memory
    all_settled = True
    gone = abs(joint)
    for number in range(PAIRS):
        way, settled = move(pairs[number], difference, joint)
        w[WAY + number] += way
        all_settled = all_settled and settled
        if number == 0:
            gone += abs(way)
    least = min(pairs[0, 0, TENSION].min(), pairs[0, 1, TENSION].min())
    if not (all_settled and least > settings[LEAST]):
        code = UNSETTLED if least > settings[LEAST] else SLACK
        return code, math.nan, math.nan, math.nan, math.nan, w[INNOVATION], w[STIFF], w[SLID] == 1.0
    w[JOINT_WAY] += joint
    end = pairs[0, 1, TENSION, n] - pairs[0, 0, TENSION, n]
    for which in range(2):
        w[GAIN_S + which] = (w[WAY + 1 + which] - w[WAY]) / MORE[which]
        w[GAIN_T + which] = (pairs[1 + which, 1, TENSION, n] - pairs[1 + which, 0, TENSION, n] - end) / MORE[which]
    keep = settings[KEEP_F]
    _rest(pairs, w, keep, 2.0 * settings[PRIOR + F], gone, settings[SETTLED])
    for which in range(2):
        w[GAIN_S + which] -= w[KNOWN] * w[HELD_S + which]
        w[GAIN_T + which] -= w[KNOWN] * w[HELD_T + which]
    error = stretch - w[ZERO] - (w[WAY] - w[JOINT_WAY]) - w[GAIN_S] * keep * w[FAST]
    w[INNOVATION] = error
    by_x, by_k = _learn(w, settings, keep, error, doubt) if w[SLID] == 1.0 else (0.0, 0.0)
    x = min(settings[HIGH], max(settings[LOW], w[ANGLE] * math.exp(by_x)))
    most = settings[MOST_STIFF]
    stiff = min(most, max(1.0 / most, w[STIFF] * math.exp(by_k)))
    by_x, by_k = math.log(x / w[ANGLE]), math.log(stiff / w[STIFF])
    if by_x != 0.0 or by_k != 0.0:
        w[ANGLE], w[STIFF] = x, stiff
        _take_over(pairs, w, 0, by_x)
        _take_over(pairs, w, 1, by_k)
        spread(pairs, x, math.exp(by_k))
    variance = _variance(w) + w[KNOWN] * w[HELD_V]
    end += w[GAIN_T] * (by_x + w[FAST]) + w[GAIN_T + 1] * by_k
    near, far = pairs[0, 1, TENSION, 0], pairs[0, 1, TENSION, n]
    return OK, end, math.sqrt(max(0.0, variance)), near, far, error, w[STIFF], w[SLID] == 1.0


@njit(cache=True, error_model="numpy")
def _learn(w: Array, settings: Array, keep: float, error: float, doubt: float) -> tuple[float, float]:
    """Apply the prediction and the correction step of the filter; return the changes of ln x and ln STIFF.

    In the prediction step, FAST decays and the variances grow slowly, at most to those of the prior.

    Args:
        keep: share of FAST that remains after a step.
        error: m, measured minus predicted elongation.
        doubt: m^2, variance of the prediction in addition to NOISE.
    """
    p, h, by_k = covariance(w), w[GAIN_S], w[GAIN_S + 1]
    for i in range(STATES):
        p[i, F] *= keep
        p[F, i] *= keep
    for i in range(STATES):
        p[i, i] = min(p[i, i] + settings[WALK + i], settings[PRIOR + i])
    gain = np.empty(STATES)
    for i in range(STATES):
        gain[i] = h * (p[i, X] + p[i, F]) + by_k * p[i, K] + p[i, Z]
    total = h * (gain[X] + gain[F]) + by_k * gain[K] + gain[Z] + settings[NOISE] + doubt
    most = _OUTLIER * math.sqrt(total)
    error = min(most, max(-most, error))
    total *= max(1.0, abs(gain[X] * error / total) / _STEP, abs(gain[K] * error / total) / _STEP)
    share = error / total
    for i in range(STATES):
        for j in range(STATES):
            p[i, j] -= gain[i] * gain[j] / total
    w[FAST] = keep * w[FAST] + gain[F] * share
    w[ZERO] = min(settings[MOST_ZERO], max(-settings[MOST_ZERO], w[ZERO] + gain[Z] * share))
    return gain[X] * share, gain[K] * share
