"""Polarity of the motor torque, tested on a simulated spring between motor and joint."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.signal import lfilter

from tsa_ctrl.safety.causes import Finding
from tsa_ctrl.safety.debounce import Debounce
from tsa_ctrl.safety.polarity_check import PATIENCE, SMALL, PolarityCheck

PERIOD = 1e-3  # s
GEARED = 1.25  # r_J/r_M
STIFFNESS = 10.0  # N*m/rad
UNKNOWN = math.nan
LIMIT = 2.0  # N*m
WRONG = "the wrong way round"

Row = tuple[float, float, float, float, float]  # torque, elongation, sensor's torque, direction of tendons, joint speed

FloatArray = NDArray[np.float64]


def filtered(values: FloatArray) -> FloatArray:
    """Return the values filtered with a memory of 0.2 s, from 0 on."""
    keep = math.exp(-PERIOD / 0.2)
    return np.asarray(lfilter([1.0 - keep], [1.0, -keep], values))


def low_passed(values: FloatArray, time: float, start: float) -> FloatArray:
    """Return the values after a low-pass with the time constant `time` (s) that was at `start` before."""
    keep = math.exp(-PERIOD / time)
    return np.asarray(lfilter([1.0 - keep], [1.0, -keep], values, zi=[keep * start])[0])


@dataclass
class Course:
    """Measurements of a random rig in each cycle."""

    torque: FloatArray
    apart: FloatArray
    tau_j: FloatArray
    sigma: FloatArray
    omega_j: FloatArray
    wound: float = 0.0
    counts: float = 0.0
    stiffness: float = 0.0
    t: FloatArray = field(init=False)

    def __post_init__(self) -> None:
        self.t = 7.0 + np.arange(self.torque.size) * PERIOD

    def band(self, values: FloatArray, since: int, first: int, end: int) -> FloatArray:
        """Return the values between 1.6 and 16 Hz: a low-pass of 10 ms minus a low-pass of 100 ms after it.

        The first low-pass starts at the first known sample from `since` on, the second one at `first`.
        """
        found = np.zeros(end - first)
        known = since + np.flatnonzero(np.isfinite(values[since:end]))
        judged = known >= first
        if judged.any():
            quick = low_passed(values[known], 0.01, values[known[0]])
            before = quick[~judged]
            slow = low_passed(quick[judged], 0.1, before[-1] if before.size else quick[0])
            found[known[judged] - first] = quick[judged] - slow
        return found

    def turns(self) -> tuple[NDArray[np.bool_], NDArray[np.intp]]:
        """Return for each cycle whether the tendon reverses, and the cycle of its last reversal (-1 for none)."""
        turned = np.diff(np.sign(self.sigma), prepend=0.0) != 0.0
        return turned, np.maximum.accumulate(np.where(turned, np.arange(turned.size), -1))

    def travel(self) -> FloatArray:
        """Return the joint travel since the last reversal of the tendon, rad at the motor, (n,)."""
        way = np.concatenate(([0.0], np.cumsum(np.nan_to_num(GEARED * PERIOD * self.omega_j))))
        return np.asarray(way[1:] - way[np.maximum(self.turns()[1], 0)])

    def held(self) -> NDArray[np.bool_]:
        """Return for each cycle whether the joint has been at rest for 0.4 s."""
        moves = ~(np.abs(self.omega_j) < 0.05)
        return np.asarray(self.t - np.maximum.accumulate(np.where(moves, self.t, -math.inf)) > 0.4)

    def pieces(self, driven: FloatArray, free: float = math.inf) -> list[tuple[int, int, bool]]:
        """Return first cycle, end and a flag of each judged interval.

        The flag is True if friction winds up the tendons there.
        """
        turned, begin = self.turns()
        travel = np.abs(self.travel())
        looked = (begin < 0) | ~(self.t < self.t[np.maximum(begin, 0)] + 0.1)
        winds = (driven > 0.0) & (travel > 0.15 * self.wound) & (travel < 1.5 * self.wound)
        looked &= self.held() | (np.arange(self.t.size) < free)
        kinds = np.where(looked, 2 * np.cumsum(turned) + winds, -1)
        starts = np.flatnonzero(np.diff(kinds, prepend=-2))
        ends = [*starts[1:].tolist(), self.t.size]
        pieces = zip(starts.tolist(), ends, strict=True)
        return [(first, end, bool(winds[first])) for first, end in pieces if kinds[first] >= 0]

    def ratios(
        self, driven: FloatArray, free: float = math.inf
    ) -> dict[int, tuple[float, float, bool, bool, bool, bool]]:
        """Return by cycle, at sufficient torque: correlation, gain of a locked joint's sensor, and four flags.

        The gain is 0 if the sensor does not follow. The flags: friction winds up; less than half of the elongation is
        the motor's motion, on tendons that may not have slid; the tendons of a locked joint give 1.5 times the
        elongation of the torque, slower than 50 rad/s; the torque exceeds possible ripple. `driven`: 1 from the cycle
        on in which something moves the joint; `free`: cycle from which on the torque may grow and only a joint at rest
        is judged.
        """
        ratio = {}
        held = self.held()
        travel = self.travel()
        active = held | (np.arange(self.t.size) < free)
        begun = np.maximum.accumulate(np.where(np.diff(active, prepend=False), np.arange(self.t.size), 0))
        for first, end, winds in self.pieces(driven, free):
            since = int(begun[first])
            t, a, j = (self.band(values, since, first, end) for values in (self.torque, self.apart, self.tau_j))
            tt, ta, aa, tj, jj = (filtered(x) for x in (t * t, t * a, a * a, t * j, j * j))
            apart = self.apart[first:end]
            least = np.fmin.accumulate(np.where(np.isnan(apart), math.inf, apart))
            most = np.fmax.accumulate(np.where(np.isnan(apart), -math.inf, apart))
            y = self.band(travel, first, first, end)
            ty, ay, yy = (filtered(x) for x in (t * y, a * y, y * y))
            with np.errstate(all="ignore"):
                share = np.clip(np.nan_to_num(ay / yy), -0.02, 0.02)  # share of the travel that wrong radii add
                stretch = np.nan_to_num((ta - share * ty) / np.sqrt(tt * (aa - 2.0 * share * ay + share**2 * yy)))
                sensor = np.nan_to_num(tj / np.sqrt(tt * jj))
            seen = most - least > 1.5 * self.counts
            sense = np.where(seen, stretch, np.where(jj > (0.01 * GEARED) ** 2, sensor, 0.0))
            own = ta + ty
            fast = seen & (own > 0.5 * ta) & (np.abs(travel[first:end]) < 1.5 * self.wound)
            gain = np.zeros(end - first)
            begins = np.flatnonzero(np.diff(held[first:end].astype(int), prepend=0) > 0).tolist()
            for begin in begins:
                rest = np.flatnonzero(~held[first + begin : end])
                part = slice(begin, begin + int(rest[0]) if rest.size else end - first)
                tt_held, tj_held, jj_held = (filtered(x[part]) for x in (t * t, t * j, j * j))
                with np.errstate(all="ignore"):
                    follows = tj_held / np.sqrt(tt_held * jj_held) > 0.8
                    # tolerance for torque that the motor adds without reporting it
                    more = 1.0 + 0.012 * LIMIT / np.sqrt(tt_held)
                    beyond = tj_held / tt_held > 1.3 * GEARED * more
                    told = follows & beyond & (tt_held > (0.005 * LIMIT) ** 2)
                    gain[part] = np.where(told, tj_held / tt_held, 0.0)
            slow = filtered(np.diff(a, prepend=0.0) ** 2) < (50.0 * PERIOD) ** 2 * aa
            strong = tt > (3.0 * 0.005 * LIMIT) ** 2
            soft = (self.stiffness * ta > 1.5 * (tt + 0.012 * LIMIT * np.sqrt(tt))) & (stretch > 0.9)
            gives = held[first:end] & seen & slow & strong & soft
            for n in np.flatnonzero(tt >= (0.005 * LIMIT) ** 2).tolist():
                enough = bool(tt[n] > (0.012 * LIMIT) ** 2)
                ratio[first + n] = (sense[n], gain[n], winds, bool(fast[n]), bool(gives[n]), enough)
        return ratio

    def foretold(self, driven: FloatArray, free: float = math.inf) -> tuple[FloatArray, int | None]:
        """Return the ceiling after each cycle, and the cycle of the finding (None if there is none)."""
        ratio, travel = self.ratios(driven, free), self.travel()
        wrong = {
            "at rest": Debounce(0.02),
            "driven": Debounce(0.25),
            "shown": Debounce(0.4),
            "excessive": Debounce(0.02),
        }
        wrong["gives"] = Debounce(0.04)
        looked = {n for first, end, _ in self.pieces(driven, free) for n in range(first, end)}
        ceiling, ceilings, shown, waited = 0.11 * LIMIT, [], False, 0.0
        suspect = fast = False
        held_for = 0.0  # s, since friction began to hold the motor
        judged = 0.0  # s
        for n, now in enumerate(self.t.tolist()):
            if shown:
                ceiling = ceiling + LIMIT * PERIOD / 0.2
                ceiling = math.inf if ceiling >= LIMIT else ceiling
                if ceiling == math.inf and free == math.inf:
                    return self.foretold(driven, n)
            else:
                if 0.0 < held_for < 0.5:
                    held_for += PERIOD
                    if abs(travel[n - 1]) > 1.5 * self.wound:
                        held_for, ceiling = math.inf, min(ceiling, 0.11 * LIMIT)
                elif held_for == 0.0 and fast:
                    held_for = PERIOD
                if now - self.t[0] > 0.1 and not suspect and not 0.0 < held_for < 0.5:
                    ceiling += LIMIT * PERIOD / (0.5 if fast else 2.0)
            ceilings.append(ceiling)
            if n not in ratio:
                suspect, fast = (False, False) if n in looked else (suspect, fast)
                continue
            sense, gain, winds, held, gives, enough = ratio[n]
            opposes = sense < -0.5
            fast, suspect = opposes and held, opposes and not held
            waited += 0.0 if opposes else PERIOD
            shown = shown or (sense > 0.5 and not winds) or waited > 0.15
            if winds:
                continue
            if fast and abs(travel[n]) > 0.15 * self.wound and not driven[n + 1 :].all():
                return self.foretold(np.where(np.arange(self.t.size) > n, 1.0, driven))  # another cause moves the joint
            judged += PERIOD
            which = "shown" if shown else "driven" if driven[n] else "at rest"
            if wrong[which].update(judged, suspect and (enough or which == "at rest")):
                return np.array(ceilings), n
            if wrong["gives"].update(judged, gives):
                return np.array(ceilings), n
            if wrong["excessive"].update(judged, 0.0 < gain < 3.0 * GEARED):
                return np.array(ceilings), n
        return np.array(ceilings), None


def run(
    sense: PolarityCheck,
    sign: float = 1.0,
    gain: float = UNKNOWN,
    seconds: float = 0.5,
    rise: float = 1.0,
    omega_j: float = 0.0,
) -> float | Finding:
    """Return the finding for a torque that rises by `rise` N*m/s, or the time (s) at which the ceiling ended."""
    free = math.inf
    for n in range(round(seconds / PERIOD)):
        torque = rise * n * PERIOD
        apart = sign * torque / STIFFNESS + 3.0
        wrong = sense.update(n * PERIOD, torque, apart, gain * GEARED * torque, 0.0, omega_j)
        if wrong is not None:
            return wrong
        if sense.ceiling == math.inf:
            free = min(free, n * PERIOD)
    return free


def told(sense: PolarityCheck, seconds: float, course: Callable[[float], Row]) -> Finding | None:
    """Return the first finding for the row that `course` returns at each time (s)."""
    for n in range(round(seconds / PERIOD)):
        found = sense.update(n * PERIOD, *course(n * PERIOD))
        if found is not None:
            return found
    return None


def check_of(wound: float = 0.0, counts: float = 0.0, stiffness: float = 0.0, slope: float = 1.0) -> PolarityCheck:
    return PolarityCheck(LIMIT, GEARED, PERIOD, wound, counts, stiffness, slope)


def test_torque_is_small_until_the_stretch_shows_its_sense_after_each_enable() -> None:
    sense = check_of()
    assert sense.ceiling == pytest.approx(LIMIT * SMALL)
    free = run(sense)
    assert isinstance(free, float)
    assert 0.02 + 0.17 < free < 0.1 + 0.17  # time in which the ceiling grows from 11 % to 100 % of the limit
    assert sense.ceiling == math.inf
    sense.reset()
    assert sense.ceiling == pytest.approx(LIMIT * SMALL)
    assert WRONG in str(run(sense, sign=-1.0))
    assert sense.ceiling == pytest.approx(LIMIT * SMALL)


@pytest.mark.parametrize("phase", [0.0, 1.0, 2.0, 3.0, 4.0, 5.0])
def test_an_oscillating_motor_is_no_reversed_one_after_a_reversal_of_the_friction(phase: float) -> None:
    """The torque rises slowly after the pause of a reversal, while the motor oscillates on its tendons at 60 Hz."""
    sense = check_of()
    for n in range(500):
        torque = LIMIT * (0.05 + 0.3 * n * PERIOD)
        swing = 0.2 * LIMIT * math.sin(2.0 * math.pi * 60.0 * n * PERIOD + phase)
        sigma = 1.0 if n > 50 else -1.0
        assert sense.update(n * PERIOD, torque, (torque + swing) / STIFFNESS, math.nan, sigma, 0.0) is None


def test_on_a_joint_that_something_else_moves_friction_that_looks_reversed_for_a_while_stops_nothing() -> None:
    """It must look reversed for a quarter of a second before it is reported. The torque does not grow meanwhile.

    At 0.5 rad/s, the tendons slide after 30 mrad at the motor.
    """
    sense = check_of()
    assert isinstance(run(sense, sign=-1.0, seconds=0.2, omega_j=0.5), float)
    assert sense.ceiling == pytest.approx(LIMIT * SMALL)
    sense.reset()
    assert WRONG in str(run(sense, sign=-1.0, seconds=0.4, omega_j=0.5))
    assert sense.ceiling == pytest.approx(LIMIT * SMALL)
    sense.reset()
    assert WRONG in str(run(sense, sign=-1.0, seconds=0.1, omega_j=0.0))
    assert WRONG in str(run(check_of(0.02), sign=-1.0, seconds=0.5, omega_j=0.5))


@pytest.mark.parametrize("sign", [UNKNOWN, 0.0], ids=["no encoder", "a rig that is too stiff for its encoders"])
def test_without_a_seen_elongation_the_joint_s_torque_shows_it(sign: float) -> None:
    assert isinstance(run(check_of(), sign, 0.5), float)
    assert WRONG in str(run(check_of(), sign, -0.5))


def test_a_joint_that_yields_says_nothing_against_its_sensor_where_no_encoder_shows_the_motor() -> None:
    """The joint moves at 0.04 rad/s in the direction of the torque, and its tendons may not have slid."""
    assert WRONG in str(told(check_of(0.05), 0.5, lambda t: (t, UNKNOWN, -0.5 * t, 1.0, 0.04)))


@pytest.mark.parametrize(("gain", "found"), [(1.2, False), (1.4, True), (2.0, True), (3.5, False)])
def test_a_motor_that_gives_more_than_it_reports(gain: float, found: bool) -> None:
    """More than three times is not a wrong torque constant but a hand that moves the limb."""
    # ripple and gear friction have little influence
    said = run(check_of(), gain=gain, rise=8.0)
    assert isinstance(said, Finding) is found
    if found:
        assert f"follows the motor's torque by {gain * GEARED:.2f}, the pulleys give 1.25" in str(said)


def test_the_joint_gets_as_much_as_tendons_transmit_that_slide() -> None:
    """With all bends at the joint and x = 0.8, the gain is cosh 0.8 = 1.34 times the ratio of the pulleys."""
    slope = math.cosh(0.8)
    assert isinstance(run(check_of(), gain=1.1 * slope, rise=8.0), Finding)
    assert isinstance(run(check_of(slope=slope), gain=1.1 * slope, rise=8.0), float)
    said = run(check_of(slope=slope), gain=2.0 * slope)
    assert f"the pulleys give {slope * GEARED:.2f}" in str(said)


def test_a_joint_that_is_moved_accuses_no_motor_of_giving_more() -> None:
    """On a moving joint, friction reverses with the motion, and the torque that it returns follows the motor torque."""
    for omega_j in (0.3, math.nan):
        assert isinstance(run(check_of(), gain=2.0, omega_j=omega_j), float)


def test_what_shows_nothing_is_not_held_up_for_longer_than_its_patience() -> None:
    free = run(check_of(), sign=0.0)
    assert isinstance(free, float)
    assert PATIENCE + 0.17 < free < PATIENCE + 0.27
    assert isinstance(run(check_of(), UNKNOWN), float)
    assert run(check_of(), sign=-1.0, rise=0.0) == math.inf  # a torque that rests shows nothing


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_set_point_that_rests_is_let_through_slowly_and_shows_its_sense_on_the_way(sign: float) -> None:
    """2 N*m are requested at once. All of it passes within two seconds, but of a reversed motor less than 0.4 N*m."""
    sense, said, most = check_of(), None, 0.0
    for n in range(2000):
        torque = min(2.0, sense.ceiling)
        most = max(most, torque)
        said = sense.update(n * PERIOD, torque, sign * torque / STIFFNESS, UNKNOWN, 0.0, 0.0)
        if said is not None:
            break
    assert (said is None) is (sign > 0.0)
    assert most == 2.0 if sign > 0.0 else most < 0.4


@pytest.mark.parametrize("rises", [1.0, 0.3], ids=["while it grows", "after it has stood at its limit"])
def test_friction_that_holds_the_motor_fast_does_not_keep_the_torque_small(rises: float) -> None:
    """Something moves the joint against the torque, and friction holds the motor.

    The motor needs more torque to slide.
    """
    sense, travel = check_of(1.0), 0.0
    for n in range(1000):
        torque = min(4.0 * min(n * PERIOD, rises), sense.ceiling)
        travel += GEARED * 0.2 * PERIOD
        assert sense.update(n * PERIOD, torque, -travel, UNKNOWN, 1.0, 0.2) is None
    assert sense.ceiling > 1.0


def drawn(number: int, kind: str) -> tuple[Course, FloatArray]:
    """Return random measurements near the thresholds, and the flag of each cycle in which the joint counts as moved."""
    draw = np.random.default_rng(number)
    count = 1200
    t = np.arange(count) * PERIOD

    def waves() -> FloatArray:
        """Return waves of 1 to 12 Hz with an RMS of about 1."""
        parts = (np.sin(2.0 * math.pi * draw.uniform(1.0, 12.0) * t + draw.uniform(0.0, 6.0)) for _ in range(3))
        return np.asarray(sum(parts) / math.sqrt(1.5))

    torque = LIMIT * 10.0 ** draw.uniform(-2.5, -1.0) * waves()
    torque[t < draw.uniform(0.0, 0.4)] = 0.0
    share = np.clip(draw.uniform(-1.2, 1.2) + draw.uniform(-1.0, 1.0) * t, -1.0, 1.0)
    other = waves() * float(np.sqrt(np.mean(np.square(torque))))
    follows = share * torque + np.sqrt(1.0 - share * share) * other
    apart, tau_j = 3.0 + follows / STIFFNESS, np.full(count, math.nan)
    sigma, omega_j = np.zeros(count), np.zeros(count)
    driven, wound, counts, stiffness = np.zeros(count), 0.0, 0.0, 0.0
    if kind == "excessive":
        apart = 3.0 + torque / STIFFNESS + 0.0 * apart
        tau_j = GEARED * (draw.uniform(1.1, 3.3) * torque + draw.uniform(0.0, 1.5) * other)
        omega_j[t < draw.uniform(-0.5, 0.8)] = 0.045 if number % 3 else math.nan
        omega_j[(t > 0.4) & (t < draw.uniform(0.0, 0.6))] = -0.06
    elif kind == "moved later":
        torque, apart = 3.0 * torque, 3.0 + 3.0 * follows / STIFFNESS
        omega_j[:], wound = 0.045, draw.uniform(0.0, 0.05)
        begun = min(Course(torque, apart, tau_j, sigma, omega_j).ratios(driven), default=count)
        omega_j[begun + 1 :] = draw.choice([0.045, 0.3])
    elif kind == "shown":
        apart = 3.0 + np.where(t < draw.uniform(0.4, 0.7), torque, draw.choice([-1.0, 0.2]) * torque) / STIFFNESS
        shown = int(np.argmax(Course(torque, apart, tau_j, sigma, omega_j).foretold(driven)[0] == math.inf))
        driven[shown:], wound = 1.0 if shown else 0.0, draw.uniform(0.0, 0.1)
    elif kind == "by sensor":
        tau_j, apart = follows, np.full(count, math.nan)
    elif kind == "moved":
        driven, wound = np.ones(count), draw.uniform(0.0, 0.05)
        omega_j = draw.choice([-1.0, 1.0]) * (0.06 + 0.1 * draw.random() * (1.0 + np.sin(3.0 * t)))
        sigma = draw.choice([-1.0, 0.4, 1.0]) * np.where(t < draw.uniform(0.2, 2.0), 1.0, draw.choice([-1.0, 0.0]))
        apart[(t > 0.7) & (t < draw.uniform(0.6, 0.8))] = math.nan
        omega_j[draw.integers(0, count, 20)] = math.nan
    elif kind == "coarse":
        counts = float(np.ptp(apart) * draw.uniform(0.05, 1.0))
        tau_j = -GEARED * follows  # shows which of the two signals is used
    elif kind == "gives":
        stiffness, share = STIFFNESS * draw.uniform(1.2, 2.2), np.clip(draw.uniform(0.8, 1.1) + 0.1 * t, 0.0, 1.0)
        apart = 3.0 + (share * torque + np.sqrt(1.0 - share * share) * other) / STIFFNESS
        omega_j[t < draw.uniform(-0.5, 0.5)] = 0.06
    elif kind == "held fast":
        apart, wound = 3.0 + (0.3 * other + draw.choice([-1.0, -1.0, 1.0]) * torque) / STIFFNESS, 0.05
        yields = draw.uniform(0.3, 0.8) * (3.0 - apart)
        omega_j = np.clip(np.diff(yields, prepend=yields[0]) / PERIOD / GEARED, -0.049, 0.049)
    return Course(torque, apart, tau_j, sigma, omega_j, wound, counts, stiffness), driven


KINDS = ("at rest", "excessive", "by sensor", "moved", "moved later", "shown", "coarse", "gives", "held fast")


@pytest.mark.parametrize("kind", KINDS)
def test_is_told_in_the_cycle_in_which_it_has_been_wrong_for_long_enough(kind: str) -> None:
    """The torques are near the smallest useful one, and the elongation follows them to a random degree."""
    detections = free = 0
    for number in range(16):
        course, driven = drawn(number, kind)
        ceilings, expected = course.foretold(driven)
        sense = check_of(course.wound, counts=course.counts, stiffness=course.stiffness)
        found, seen = None, []
        columns = (course.t, course.torque, course.apart, course.tau_j, course.sigma, course.omega_j)
        for n, row in enumerate(zip(*(column.tolist() for column in columns), strict=True)):
            said = sense.update(*row)
            seen.append(sense.ceiling)
            if said is not None:
                found = n
                break
        assert found == expected, number
        assert seen == pytest.approx(ceilings.tolist(), rel=1e-9), number
        detections, free = detections + (found is not None), free + (math.inf in seen)
    assert detections > 0
    assert free > 2


def cycles_until_told(
    sense: PolarityCheck, begin: float, sign: float, gain: float, omega_j: float, most: int = 2000
) -> int:
    """Return the number of cycles until detection, with a clock that starts at `begin` (s)."""
    for n in range(most):
        torque = n * PERIOD
        apart = (abs(sign) if n < 300 and sign == -0.5 else sign) * torque / STIFFNESS
        if sense.update(begin + n * PERIOD, torque, apart, gain * GEARED * torque, 0.0, omega_j) is not None:
            return n
    return most


@pytest.mark.parametrize(
    ("sign", "gain", "omega_j", "softer"),
    [
        (-1.0, UNKNOWN, 0.0, 0.0),
        (-1.0, UNKNOWN, 0.5, 0.0),
        (-0.5, UNKNOWN, 0.0, 0.0),
        (1.0, 2.0, 0.0, 0.0),
        (1.0, UNKNOWN, 0.0, 2.0),
    ],
)
def test_a_reset_forgets_for_how_long_it_has_been_wrong(
    sign: float, gain: float, omega_j: float, softer: float
) -> None:
    """The cases: at rest, moved externally, shown to be right before, and excessive torque by sensor or elongation."""
    sense = check_of(stiffness=softer * STIFFNESS)
    alone = cycles_until_told(sense, 0.0, sign, gain, omega_j)
    assert alone < 2000
    sense = check_of(stiffness=softer * STIFFNESS)
    cycles_until_told(sense, 0.0, sign, gain, omega_j, alone)
    sense.reset()
    assert cycles_until_told(sense, alone * PERIOD, sign, gain, omega_j) == pytest.approx(alone, abs=1)


@pytest.mark.parametrize(("softer", "found"), [(0.7, False), (1.0, False), (1.3, False), (2.0, True), (4.0, True)])
def test_tendons_that_give_more_than_the_torque_stretches_them_by(softer: float, found: bool) -> None:
    """The motor delivers more torque than it reports, or a tendon hangs. On a moving joint, friction may cause this."""
    sense = check_of(stiffness=STIFFNESS * softer)
    said = run(sense, seconds=0.6, rise=2.0)
    assert isinstance(said, Finding) is found
    assert not found or f"give {softer:.1f} times" in str(said)
    sense = check_of(stiffness=STIFFNESS * softer)
    assert isinstance(run(sense, seconds=0.6, rise=2.0, omega_j=0.5), float)


def test_a_stiffness_that_is_unknown_and_counts_that_are_coarse_accuse_nothing() -> None:
    assert isinstance(run(check_of(), sign=20.0, seconds=0.6, rise=2.0), float)
    assert isinstance(run(check_of(counts=0.5, stiffness=2.0 * STIFFNESS), seconds=0.6, rise=2.0), float)


def test_a_joint_that_has_just_come_to_rest_says_nothing_of_the_motor_by_its_sensor_yet() -> None:
    """The joint pulley has half the radius. Its torque follows by r_J/r_M and was small since the joint was locked."""

    def course(t: float) -> Row:
        torque = 0.018 * math.sin(2.0 * math.pi * 4.0 * t)
        return torque, torque / STIFFNESS, 0.5 * torque, 1.0, 0.3 if t < 0.1 else 0.0

    assert told(PolarityCheck(LIMIT, 0.5, PERIOD, wound=0.0, counts=0.0, stiffness=0.0, slope=1.0), 0.9, course) is None


def test_a_motor_that_begins_to_give_twice_is_found_by_what_its_torque_adds() -> None:
    """A sine of 1 N*m at 2 Hz was shown to be right for a second. Friction winds 3 mrad back and forth meanwhile."""
    sense, said, when = check_of(0.02, stiffness=40.0), None, 0.0
    for n in range(2000):
        t = n * PERIOD
        torque = math.sin(2.0 * math.pi * 2.0 * t)
        gain = 2.0 if t > 1.0 else 1.0
        apart = gain * torque / 40.0 + 0.003 * math.sin(2.0 * math.pi * 0.7 * t)
        said = said or sense.update(t, torque, apart, UNKNOWN, 1.0, 0.0)
        when = when or (t if said else 0.0)
    assert "give" in str(said)
    assert 1.0 < when < 1.35


def swung(error: float, elongation: float, frequency: float) -> list[str | None]:
    """Return the finding of each cycle for a joint that swings by half a radian.

    The radii are wrong by `error`. `elongation` is in rad at the motor at the torque's amplitude, and negative for a
    reversed motor.
    """
    t, beats = np.arange(3000) * PERIOD, 2.0 * math.pi * 1.3
    wave = np.sin(2.0 * math.pi * frequency * t)
    apart = GEARED * error * 0.5 * np.sin(beats * t) + elongation * wave
    columns = (
        t,
        0.1 * LIMIT * wave,
        apart,
        np.full(t.size, math.nan),
        np.ones(t.size),
        0.5 * beats * np.cos(beats * t),
    )
    check = check_of()
    return [check.update(*row) for row in zip(*(column.tolist() for column in columns), strict=True)]


@pytest.mark.parametrize("error", [-0.015, -0.01])
def test_a_ratio_of_the_radii_that_is_off_looks_like_no_reversed_motor(error: float) -> None:
    """The torque swings with the joint.

    It elongates the tendons less than the radius error seems to, in the other direction.
    """
    assert not any(swung(error, 0.004, 1.3))


@pytest.mark.parametrize("error", [-0.015, 0.0, 0.015])
def test_a_ratio_of_the_radii_that_is_off_hides_no_reversed_motor(error: float) -> None:
    assert any(swung(error, -0.01, 1.9))


def test_a_ripple_on_a_moving_joint_is_no_reversed_motor() -> None:
    """The torque sensor follows a ripple of 4 % of the torque limit, which exceeds the torque and opposes it.

    The tendons are so stiff that the encoders do not show their elongation.
    """
    sense, angle = check_of(counts=1e-4, stiffness=4000.0), 0.0
    for n in range(4000):
        angle += GEARED * 0.8 * PERIOD
        torque = -0.04 * math.sin(10.0 * angle)
        delivered = torque + 0.04 * LIMIT * math.sin(10.0 * angle)
        assert sense.update(n * PERIOD, torque, 0.0, GEARED * delivered - 0.5, 1.0, 0.8) is None
