# mypy: disallow-untyped-decorators=False
"""A pair of tendons in their sheaths, contact by contact: slip fronts as state, compiled and cached.

Each tendon is N + 1 springs between N contacts, spring 0 at the motor. A contact holds as long as the capstan allows,

    T_i e^-x_i <= T_{i+1} <= T_i e^x_i,     |T_i - T_{i+1}| <= g_i (T_i + T_{i+1}),  g_i = tanh(x_i / 2)

and slips by delta_i, counted to the motor, along the friction that holds it. A step moves the joint ends by -+dv and
both motor ends by the same -+du, which is the one that gives T3 - T1 = tau_M/r_M: the motor is known by its torque, the
joint by its angle. (Both by their angles, tensions near a turn would follow single counts of the motor's encoder.)
Which contacts slip is found by Newton's method on the set of them, each step one tridiagonal system. The state is the
tensions alone: partial reversals and their return points are in it.
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
SHARE = 2  # 1, of the bending, of contact i
GRIP = 3  # 1, of contact i
MODE = 4  # of contact i: 0 holds, 1 slips to the motor, -1 to the joint
UPPER, SLIP, BY_MOTOR, NEW = 5, 6, 7, 8  # of the elimination: delta = SLIP + BY_MOTOR du; NEW: tensions tried
HELD = 9  # and the next: N of spring i, between the first pair and the others when the joint's end came to rest
ROWS = 11
ROUNDS = 60  # of Newton's method; one or two are usual, one for each contact that a step passes is the most
PIECES = 8  # into which a step is cut whose modes were not found
_FORCE = 1e-7  # N beyond the grip that still holds
_BACK = 1e-13  # m of slip against the friction that is rounding


@njit(cache=True, error_model="numpy")
def grip(pair: Array, x: float) -> None:
    """Set the friction angle x of both tendons, (2, ROWS, N + 1)."""
    for i in range(pair.shape[2] - 1):
        g = math.tanh(0.5 * x * pair[0, SHARE, i])
        pair[0, GRIP, i] = g
        pair[1, GRIP, i] = g


@njit(cache=True, error_model="numpy")
def _solve(c: Array, joint: float) -> None:
    """Slip of all contacts for the present modes, by Thomas's elimination; `joint`: m that its end moves."""
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
    """Tensions tried and modes corrected, ends moved by `motor` and `joint` m; True when no mode had to change."""
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
    """Newton's method on the modes; the tensions found are taken over when they settled."""
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
    """Advance tendons a and b: T3 - T1 = `difference` (N), the joint's pulley turned by `joint` (m).

    Returns the way (m) that the motor's pulley made, and whether the set of slipping contacts was found.
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
    """A whole log, (n,) each: stretch (m) since its begin, T4 - T2 (N; nan where not found), 1 once all has slid."""
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


# State of `observe` between two calls, a row of floats.
ANGLE = 0  # friction angle x of the tendons as they are now, 1
ZERO = 1  # m of elongation that the encoders show where there is none
FAST = 2  # 1, friction beyond x that is not expected to stay
STIFF = 3  # 1, stiffness over the model's
SLID = 4  # 1 once both tendons have slid all along, however they lay at the start: their earlier values are forgotten
INNOVATION = 5  # m
REST = 6  # 1, from when the joint's end rests until all slides again: how surely the tensions were known then
KNOWN = 7  # 1, share of what was held that counts as known
HELD_V = 8  # N^2, variance of T4 - T2 when the joint's end came to rest
JOINT_WAY = 9  # m that the joint has made
WAY = 10  # and the next two: m that the motor has made, by each pair
GAIN_S, GAIN_T = 13, 15  # two each: m and N by which stretch and T4 - T2 grow with ln x and ln STIFF
HELD_S, HELD_T = 17, 19  # the same when the joint's end of both tendons came to rest
SLIDING = 21  # m that motor and joint have made while both tendons slid all along, one way
SENSE = 22  # -1 or 1, that way; 0 before any
TURNED = 23  # 1 when it was the other way before
COVARIANCE = 24  # from here on, (4, 4)
STATES = 4
X, K, F, Z = 0, 1, 2, 3  # ln x, ln STIFF, FAST, ZERO (m)
MEMORY = COVARIANCE + STATES * STATES
# Constants of the filter.
LOW, HIGH = 0, 1  # of x
MOST_ZERO = 2  # m, either way
MOST_STIFF = 3  # factor either way
PRIOR = 4  # and the next three: variances of the states at the start, and the most that they grow to again
WALK = 8  # and the next three: variance a step gains
KEEP_F = 12  # share of FAST that a step leaves
NOISE = 13  # m^2 of a stretch measured
LEAST = 14  # N, tension below which a tendon is slack
SETTLED = 15  # m of SLIDING, after which all slides whatever was before; a quarter of it where that was the other way
SETTINGS = 16
PAIRS = 3  # as they are, with other friction, with other stiffness
MORE = (-0.05, 0.05)  # 1, of x and of the stiffness; less x, so that it slips before the first does, and never too late
_OUTLIER = 5.0  # standard deviations beyond which an innovation counts no more
_STEP = 0.05  # 1, of ln x and ln STIFF, most in a cycle, as the tensions must follow: what asks for more counts less
OK, UNSETTLED, SLACK = 0, 1, 2


@njit(cache=True, error_model="numpy")
def covariance(memory: Array) -> Array:
    """The part of the memory that is the covariance, as it lies there."""
    found: Array = memory[COVARIANCE : COVARIANCE + STATES * STATES].reshape((STATES, STATES))
    return found


@njit(cache=True, error_model="numpy")
def _rest(pairs: Array, w: Array, keep: float, sure: float, way: float, settled: float) -> None:
    """Separate the part that no longer depends on x and stiffness: tensions at a joint's end at rest, measured while
    all slid.

    As far as x, and not the zero, was known then: `sure` is the variance of ln x at which half of it counts. `way`: m
    that motor and joint made in this step; `settled`: see SETTLED.
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
    """N^2, of T4 - T2, as far as friction and stiffness decide it."""
    p, by_x, by_k = covariance(w), w[GAIN_T], w[GAIN_T + 1]
    found = by_x * by_x * (p[X, X] + 2.0 * p[X, F] + p[F, F]) + 2.0 * by_x * by_k * (p[X, K] + p[F, K])
    return float(found + by_k * by_k * p[K, K])


@njit(cache=True, error_model="numpy")
def _take_over(pairs: Array, w: Array, which: int, change: float) -> None:
    """Another x or stiffness, by `change` of its logarithm, and the tensions that would be there had it been so before.

    As far as they are not known from when the joint's end came to rest.
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
    """Give the pairs their friction angles, and `stiffer` times the stiffness that they have."""
    for number in range(PAIRS):
        grip(pairs[number], (1.0 + MORE[0]) * x if number == 1 else x)
        for tendon in range(2):
            for i in range(pairs.shape[3]):
                pairs[number, tendon, STIFFNESS, i] *= stiffer


@njit(cache=True, error_model="numpy")
def observe(
    pairs: Array, memory: Array, settings: Array, difference: float, stretch: float, joint: float, doubt: float = 0.0
) -> tuple[int, float, float, float, float, float, float, bool]:
    """Advance all pairs, which differ by `MORE`, by a cycle: predict the elongation and correct it by the measured one.

    `pairs` (3, 2, ROWS, N + 1); `difference`: T3 - T1 in N; `stretch`: s in m; `joint`: m, motion of the joint's pulley
    since the last cycle; `doubt`: m^2, variance of the prediction in addition to NOISE. The prediction is not corrected
    before SLID, because the state of the tendons is unknown. Returns a code, T4 - T2 (N), its standard deviation by the
    tendons (N), the tensions of tendon b at motor and joint (N), the innovation (m), STIFF, and True if SLID is 1.
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
    """A step of the states by themselves, then what a stretch changes; returns the changes of ln x and ln STIFF.

    FAST forgets, the others walk slowly, never further than the prior. `error`: m by which the stretch was foretold
    wrongly.
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
