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

STIFFNESS = 0  # N/m of spring i
TENSION = 1  # N of spring i
SHARE = 2  # 1, of the bending, of contact i
GRIP = 3  # 1, of contact i
MODE = 4  # of contact i: 0 holds, 1 slips to the motor, -1 to the joint
UPPER, SLIP, BY_MOTOR, NEW = 5, 6, 7, 8  # of the elimination: delta = SLIP + BY_MOTOR du; NEW: tensions tried
HELD = 9  # N of spring i, between the pairs when the joint's end came to rest
ROWS = 10
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


# What `observe` keeps between two calls, a row of floats.
ANGLE = 0  # friction angle x of the tendons as they are now, 1
ZERO = 1  # m of stretch that the encoders show where there is none
FAST = 2  # 1, friction beyond x that is not expected to stay
WAY, WAY_MORE, JOINT_WAY = 3, 4, 5  # m that motor (of both pairs) and joint have made
P_XX, P_XF, P_XZ, P_FF, P_FZ, P_ZZ = 6, 7, 8, 9, 10, 11  # covariance of ln x, FAST and ZERO
SLID = 12  # 1 once both tendons have slid all along: what they were before is forgotten
INNOVATION = 13  # m
GAIN_S, GAIN_T = 14, 15  # m and N by which stretch and T4 - T2 grow with ln x
HELD_S, HELD_T = 16, 17  # GAIN_S and GAIN_T when the joint's end of both tendons came to rest
REST = 18  # 1, from then until all slides again: how surely the tensions were known then
KNOWN = 19  # 1, share of what was held that counts as known
HELD_V = 20  # N^2, variance of T4 - T2 when the joint's end came to rest
MEMORY = 21
# What it is told once.
LOW, HIGH = 0, 1  # of x
MOST_ZERO = 2  # m, either way
PRIOR_X, PRIOR_Z, SPREAD_F = 3, 4, 5  # variances: 1, m^2, 1
WALK_X, WALK_Z, KEEP_F = 6, 7, 8  # variance a step gains; share of FAST that a step leaves
NOISE = 9  # m^2 of a stretch measured
LEAST = 10  # N, tension below which a tendon is slack
SETTINGS = 11
MORE = -0.05  # 1, of x, that the second pair has: less, so that it slips before the first one does, and never too late
_OUTLIER = 5.0  # standard deviations beyond which an innovation counts no more
_STEP = 0.05  # 1, of ln x, most in a cycle: the tensions must follow
OK, UNSETTLED, SLACK = 0, 1, 2


@njit(cache=True, error_model="numpy")
def _rest(pairs: Array, w: Array, h: float, g: float, keep: float, sure: float) -> None:
    """Keep apart what no longer depends on x: tensions at a joint's end at rest were measured while all slid.

    As far as x, and not the zero, was known then: `sure` is the variance of ln x at which half of it counts.
    """
    n = pairs.shape[3] - 1
    slides = True
    for i in range(n):
        slides = slides and pairs[0, 0, MODE, i] != 0.0 and pairs[0, 1, MODE, i] != 0.0
    if slides:
        w[SLID] = 1.0
        w[REST] = 0.0
    elif w[REST] == 0.0 and pairs[0, 0, MODE, n - 1] == 0.0 and pairs[0, 1, MODE, n - 1] == 0.0:
        w[REST] = sure / (sure + w[P_XX])
        w[HELD_V] = g * g * (w[P_XX] + 2.0 * w[P_XF] + w[P_FF])
        w[HELD_S], w[HELD_T] = h, g
        for tendon in range(2):
            for i in range(n + 1):
                pairs[0, tendon, HELD, i] = pairs[1, tendon, TENSION, i] - pairs[0, tendon, TENSION, i]
    w[KNOWN] = keep * w[KNOWN] + (1.0 - keep) * w[REST] * w[SLID]


@njit(cache=True, error_model="numpy")
def _take_over(pairs: Array, x: float, share: float, known: float) -> None:
    """Another friction angle, and the tensions that would be there had it been so since the joint's end came to rest.

    `known`: of the differences held then; 0: as if it had always been so.
    """
    for tendon in range(2):
        for i in range(pairs.shape[3]):
            difference = pairs[1, tendon, TENSION, i] - pairs[0, tendon, TENSION, i]
            change = share * (difference - known * pairs[0, tendon, HELD, i])
            pairs[0, tendon, TENSION, i] += change
            pairs[1, tendon, TENSION, i] += change
    grip(pairs[0], x)
    grip(pairs[1], (1.0 + MORE) * x)


@njit(cache=True, error_model="numpy")
def observe(
    pairs: Array, memory: Array, settings: Array, difference: float, stretch: float, joint: float
) -> tuple[float, float, int]:
    """One cycle of two pairs, the second with `MORE` friction: predict the stretch, learn from the one measured.

    `pairs` (2, 2, ROWS, N + 1); `difference`: T3 - T1 in N; `stretch`: s in m; `joint`: m by which the joint's pulley
    has turned since. Returns T4 - T2 (N), its standard deviation as far as the friction decides it (N), and a code.
    """
    n = pairs.shape[3] - 1
    w = memory
    way, settled = move(pairs[0], difference, joint)
    more, settled_more = move(pairs[1], difference, joint)
    least = min(pairs[0, 0, TENSION].min(), pairs[0, 1, TENSION].min())
    if not (settled and settled_more and least > settings[LEAST]):
        return math.nan, math.nan, UNSETTLED if least > settings[LEAST] else SLACK
    w[WAY] += way
    w[WAY_MORE] += more
    w[JOINT_WAY] += joint
    end = pairs[0, 1, TENSION, n] - pairs[0, 0, TENSION, n]
    h = (w[WAY_MORE] - w[WAY]) / MORE
    g = (pairs[1, 1, TENSION, n] - pairs[1, 0, TENSION, n] - end) / MORE
    keep = settings[KEEP_F]
    _rest(pairs, w, h, g, keep, 2.0 * settings[SPREAD_F])
    h -= w[KNOWN] * w[HELD_S]
    g -= w[KNOWN] * w[HELD_T]
    # ln x and the zero walk, never further than the prior; FAST forgets
    xx, xf, xz = min(w[P_XX] + settings[WALK_X], settings[PRIOR_X]), keep * w[P_XF], w[P_XZ]
    ff, fz = keep * keep * w[P_FF] + (1.0 - keep * keep) * settings[SPREAD_F], keep * w[P_FZ]
    zz = min(w[P_ZZ] + settings[WALK_Z], settings[PRIOR_Z])
    w[FAST] *= keep
    gx, gf, gz = h * (xx + xf) + xz, h * (xf + ff) + fz, h * (xz + fz) + zz
    total = h * (gx + gf) + gz + settings[NOISE]
    error = stretch - w[ZERO] - (w[WAY] - w[JOINT_WAY]) - h * w[FAST]
    w[INNOVATION] = error
    most = _OUTLIER * math.sqrt(total)
    error = min(most, max(-most, error))
    change = min(_STEP, max(-_STEP, gx / total * error))
    w[FAST] += gf / total * error
    w[ZERO] = min(settings[MOST_ZERO], max(-settings[MOST_ZERO], w[ZERO] + gz / total * error))
    w[P_XX], w[P_XF], w[P_XZ] = xx - gx * gx / total, xf - gx * gf / total, xz - gx * gz / total
    w[P_FF], w[P_FZ], w[P_ZZ] = ff - gf * gf / total, fz - gf * gz / total, zz - gz * gz / total
    w[GAIN_S], w[GAIN_T] = h, g
    x = min(settings[HIGH], max(settings[LOW], w[ANGLE] * math.exp(change)))
    change = math.log(x / w[ANGLE])
    if change != 0.0:
        w[ANGLE] = x
        _take_over(pairs, x, change / MORE, w[KNOWN])
        w[WAY] += change * h
        w[WAY_MORE] += change * h
    variance = w[P_XX] + 2.0 * w[P_XF] + w[P_FF]
    variance = g * g * variance + w[KNOWN] * w[HELD_V]
    return end + g * (change + w[FAST]), math.sqrt(max(0.0, variance)), OK
