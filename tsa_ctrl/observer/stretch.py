"""Estimate the joint torque on-line from two encoders and the motor torque, with a 95 % band.

No torque sensor and no known load are required. The tendons are simulated contact by contact (`tendons`). Inputs are
the motor torque minus the inertia's part, tau_M - J_M alpha_M, and the joint angle. The simulation predicts the
elongation s = r_M q_M - r_J q_J. A difference from the measured s is an error of the friction or the stiffness, or a
drift of the zero of s. An extended Kalman filter separates them: ln x, the stiffness and the zero drift slowly, and a
fourth state is temporary friction.

While the tendons slide, the estimate is the line of `tsa_ctrl.model.stretch`. During a reversal that line has an error
of up to half the friction, and the slip fronts determine the estimate.

x means x T_p here, because only the product is identifiable. Friction and pretension may therefore be unknown.
The stiffness must be known within its [uncertainty]: it is the inverse of the slope of s over tau_M while all tendons
slide, for any friction. The curvature profile must be known: [uncertainty] bending_centre is a part of the band. During
a reversal the profile itself is a part as well, and is larger if the file has only the centre of the bends.

The joint torque is the torque of the tendons at the joint pulley, r_J (T4 - T2), before any friction in the joint.
"""

from __future__ import annotations

import math
from enum import Enum

import numpy as np

from tsa_ctrl.errors import UsageError
from tsa_ctrl.model.functions import Array
from tsa_ctrl.model.parameters import TendonSheath
from tsa_ctrl.model.stretch import profile_of, stretch_line
from tsa_ctrl.observer import tendons

MISFIT = 3.0  # standard deviations of the innovation, beyond which motor torque or tendons differ from the model
SMOOTH = 0.005  # s, low-pass of the innovation
# Cycles in a row that count. In each the observer changes its friction by a twentieth at most, so after 10 it has
# followed friction that is a standard deviation of the prior off. At 1 kHz healthy rigs show four in a row at most.
LASTING = 10


class Confirmation:
    """Compare the innovations of the elongation observer with their uncertainty, to confirm the reported motor torque.

    `confirmed`: True while the elongation was as predicted since the last reset, except for single samples.
    """

    def __init__(self, model: TendonSheath, noise: float, period: float) -> None:
        """Prepare the test; `noise`: m^2 of one measured elongation; `period`: s."""
        self._stiffest = math.exp(model.axial_stiffness_uncertainty)
        self._softest = 1.0 / self._stiffest
        self._noise = float(noise)
        self._least = MISFIT**2 * self._noise  # m^2: the variance is never less than the noise
        self._share = 1.0 - math.exp(-period / SMOOTH)
        self.reset()

    def reset(self) -> None:
        """Begin again."""
        self.confirmed = True
        self._innovation = 0.0  # m
        self._beyond = 0  # cycles in a row

    def update(self, innovation: float, stiff: float, slid: bool, memory: Array) -> None:
        """Compare the innovation (m) with its standard deviation, and the stiffness (1) with the bounds of the file.

        Args:
            innovation, stiff, slid: of `tendons.observe`.
            memory: of `tendons`, with the uncertainty of its states.
        """
        self._innovation += self._share * (innovation - self._innovation)
        if not self.confirmed:
            return
        squared = self._innovation**2
        if squared <= self._least and self._softest <= stiff <= self._stiffest:  # as expected whatever is known
            self._beyond = 0
            return
        if not slid:
            return
        by_x, by_k = float(memory[tendons.GAIN_S]), float(memory[tendons.GAIN_S + 1])
        x, k, passing, zero = memory[tendons.COVARIANCE :: tendons.STATES + 1].tolist()
        variance = by_x * by_x * (x + passing) + by_k * by_k * k + zero + self._noise
        off = not self._softest <= stiff <= self._stiffest
        self._beyond = self._beyond + 1 if off or squared > MISFIT**2 * variance else 0
        self.confirmed = self._beyond < LASTING


CONTACTS = 12  # a tendon; 6 are 1 mN*m worse on the shipped actuator, 24 no better and twice as dear
NEAR = 1e-3  # 1, of the length, within which bends are one contact, and the shortest spring: far below what x shows
FRICTION_PRIOR = 0.5  # 1, standard deviation of ln x at the start and the most it grows to again
FRICTION_WALK = 0.07  # 1 per root of s: 40 % within 10 s is 1.5 standard deviations
PASSING, PASSING_TIME = 0.015, 0.05  # 1 and s: friction that comes and goes, of x; more hides the stiffness
ZERO_WALK = 0.3e-6  # m per root of s: creep and warmth, 20 um in an hour and a quarter
FACTOR = 4.0  # of x either way
STIFF_WALK = 1e-4  # 1 per root of s, of ln k: a tendon that softens by 1 % in an hour
# 1, times the stretch that friction can hide: the model's tendons begin level, and when they slide, those that lay the
# other way and have half as much friction again need twice that still; after a turn half is enough for a quarter more
SURELY = 2.0
NEARLY = 0.99  # 1, of a bound, that counts as reached
STIFF_FACTOR = 1.5  # of the stiffness either way; more is another tendon
TORQUE_NOISE = 2e-3  # N*m at the motor, standard deviation of the torque that drives report; the simulated one's
# s, uncertainty of the delay between torque and angles while the elongation changes: half of a current loop's delay.
# A trembling hand makes only reversals, and without this term the filter learns a wrong stiffness from them.
TIME_DOUBT = 0.3e-3
COUNTS = 6.0  # times the variance of a count: its error stays the same from cycle to cycle while things move slowly
# Factor of the variance of a measured elongation, because errors of the tendon model are correlated in time. With 100,
# the joint receives 50 mJ before a loss of pretension is detected. With 20, a wrong stiffness causes an error of 3.4 %
# of a held torque.
ALIKE = 28.0
SLACK = 0.02  # 1, of the pretension, below which a tendon counts as slack
LONGEST_GAP = 0.05  # s without measurements after which the fronts are not known any longer
RESTART = 1.0  # s without measurements after which an encoder may have been switched on anew: boot-ups take longer
BAND = 1.96  # standard deviations of 95 %
# 1, of the variance that the filter has of the tendons: it is told of more friction that walks and passes than tendons
# show, to follow a change of 40 % within 10 s; with all of it the band is three times as wide as it must be. By this
# and `TOLD` the band holds 95 to 97 % of the samples of simulated rigs on average (tools/run bench/stretch); of one rig
# more or less, as the residual is not noise
OF_TENDONS = 0.035
# 1, error over the friction torque in the middle of a reversal, if the file has only the centre of the bends. Two bends
# with a straight piece between them change the slip fronts by this much (5.3 % RMS over the reversal).
COURSE = 0.06
TOLD = 0.01  # 1, the same if the file has the curvature profile that tsa calibrate --stretch determines
# 1, standard deviation in the middle of a reversal over the elongation that friction can hide. A wrong profile causes
# the same error in all samples of a reversal, so they count like a single sample with an error of some percent.
# With the noise of single samples, each reversal of a locked joint leaves a friction error of 2 %, and twice the torque
# error.
TURN_DOUBT = 1.0
# 1, of the same, beside the noise, and s: by more than this no course misleads, on simulated rigs with a calibrated
# file; what was more within that time is friction or stiffness that is off, and turns teach all that they say. A file
# whose friction is 24 % off needs them: without, its first strokes end at a stiffness that is half as much again
MISLED, MISLED_FOR = 0.05, 1.0


class StretchState(Enum):
    """Values are the log's codes."""

    NONE = 0  # no two encoders, or a profile for which the elongation determines nothing
    UNSLID = 1  # the tendons have not slid all along yet: the band holds all that the friction may hide
    TOLD = 2
    SLACK = 3  # a tendon is, or the motor's torque is beyond the domain: nothing is reported


class StretchObserver:
    """Estimate the joint torque; takes a few microseconds a cycle.

    Attributes: `torque`, `low`, `high`: N*m at the joint, nan while it cannot be estimated. `stiffness`: 1, stiffness
    of the tendons (and of a series spring) over the model file's. `innovation`: m, measured minus predicted elongation
    of the last cycle.
    """

    def __init__(
        self, model: TendonSheath, period: float, counts: tuple[float, float], motor_inertia: float = 0.0
    ) -> None:
        """`period` in s; `counts`: rad of one count at the motor's and the joint's pulley; J_M in kg*m^2.

        Raises UsageError if the elongation determines nothing for the profile of the sheath, or nothing elongates.
        """
        if not (model.friction_angle > 0.0 and model.pretension > 0.0):
            raise UsageError(
                f"{model.source or 'model'}: friction angle {model.friction_angle:g} and pretension "
                f"{model.pretension:g} N: both must be above 0 for the tendons' stretch to be followed"
            )
        self._line = stretch_line(model)
        self._model = model
        self._period = period
        self._inertia = motor_inertia
        r_m, r_j = model.motor_pulley_radius, model.joint_pulley_radius
        self._r_m, self._r_j = r_m, r_j
        self._first = pairs_of(model)
        self._pairs = self._first.copy()
        self._memory = np.zeros(tendons.MEMORY)
        self._settings = _settings(model, period, (r_m * counts[0], r_j * counts[1]), self._line.centre)
        self._friction = 2.0 * r_j * model.pretension * model.friction_angle  # N*m, the half loop
        per_torque = r_j / r_m
        self._noise = (per_torque * TORQUE_NOISE) ** 2
        self._bent = (model.bending_centre_uncertainty / BAND / (1.0 - self._line.centre)) ** 2
        self._per_torque = per_torque
        known = "elongation_coupling" in model.effects or model.bending_course is not None
        self._turn_variance = ((TOLD if known else COURSE) * self._friction) ** 2
        hidden = _hidden(model, self._line.centre)
        self._turn_noise = (TURN_DOUBT * hidden) ** 2
        self._misled = MISLED * hidden + 2.0 * math.sqrt(self._settings[tendons.NOISE] / ALIKE)
        self._keep_misfit = math.exp(-period / MISLED_FOR)
        self.confirmation = Confirmation(model, self._settings[tendons.NOISE] / ALIKE, period)
        self.pretension = model.pretension  # N, at which x is reported
        self.modelled = model.friction_angle  # 1, x of the model at the present wrap angle
        self._modelled_pretension = model.pretension  # N, of the model there
        self.most_friction_angle = model.most_friction * model.friction_angle  # 1, at the file's pretension
        tendons.observe(self._pairs, self._memory + 1.0, self._settings, 0.0, 0.0, 0.0, 0.0)  # compiles
        self.reset()

    def reset(self) -> None:
        """Reset everything, also the zero of s; the next measurement begins again."""
        self._gap = 0.0
        self.confirmation.reset()
        self._origin = math.nan  # m of stretch at the first measurement, from which the zero is counted
        self._memory[:] = 0.0
        settings, memory = self._settings, self._memory
        memory[tendons.ANGLE] = self.modelled * self._modelled_pretension / self.pretension
        memory[tendons.STIFF] = self.stiffness = 1.0
        self.innovation = 0.0
        for state in range(tendons.STATES):
            memory[tendons.COVARIANCE + (tendons.STATES + 1) * state] = settings[tendons.PRIOR + state]
        self._lose()

    def _lose(self) -> None:
        """Forget where the fronts are; the estimates of friction and zero stay."""
        self.state = StretchState.UNSLID
        self.torque = self.low = self.high = math.nan
        self._last = math.nan  # m, the joint's way
        self._omega = self._stretch = math.nan
        self._misfit = self._misled_by = 0.0  # m, the largest recent innovation; m^2, see `_misleads`

    def _begin(self, stretch: float) -> None:
        """Tensions level along each tendon, by the stretch (m) that there is."""
        if self._origin != self._origin:
            self._origin = stretch
        memory = self._memory
        stiffness = float(memory[tendons.STIFF]) * self._model.tendon_stiffness
        most = 0.9 * self.pretension / stiffness
        real = min(most, max(-most, stretch - self._origin - float(memory[tendons.ZERO])))
        self._pairs[:] = self._first
        for number, factor in enumerate((1.0, 1.0, 1.0 + tendons.MORE[1])):
            self._pairs[number, :, tendons.STIFFNESS] *= factor * memory[tendons.STIFF]
            self._pairs[number, 0, tendons.TENSION] -= factor * stiffness * real
            self._pairs[number, 1, tendons.TENSION] += factor * stiffness * real
            memory[tendons.WAY + number] = real
        memory[tendons.JOINT_WAY] = memory[tendons.SLID] = memory[tendons.FAST] = 0.0
        memory[tendons.SLIDING] = memory[tendons.SENSE] = memory[tendons.TURNED] = 0.0
        memory[tendons.REST] = memory[tendons.KNOWN] = 0.0
        self._grip()

    @property
    def friction_angle(self) -> float:
        """x (1) that goes with `pretension`: only the product of both is determined."""
        return float(self._memory[tendons.ANGLE])

    @property
    def friction_deviation(self) -> float:
        """Standard deviation of ln x."""
        return math.sqrt(max(0.0, float(self._memory[tendons.COVARIANCE])))

    @property
    def stiffness_deviation(self) -> float:
        """Standard deviation of its logarithm."""
        place = tendons.COVARIANCE + (tendons.STATES + 1) * tendons.K
        return math.sqrt(max(0.0, float(self._memory[place])))

    @property
    def at_bound(self) -> bool:
        """Return True if stiffness or friction would have to be beyond their bounds: these are other tendons."""
        memory, told = self._memory, self._settings
        stiff, x, most = memory[tendons.STIFF], memory[tendons.ANGLE], told[tendons.MOST_STIFF]
        inside = 1.0 / most < NEARLY * stiff and stiff < NEARLY * most
        return not (inside and told[tendons.LOW] < NEARLY * x and x < NEARLY * told[tendons.HIGH])

    @property
    def zero(self) -> float:
        """Elongation that the encoders show where there is none, m."""
        return self._origin + float(self._memory[tendons.ZERO])

    def set_pretension(self, value: float) -> None:
        """Go on at another T_p0 (N), and the friction angle that has the same product with it."""
        if not value > SLACK * self._model.pretension or value == self.pretension:
            return
        memory = self._memory
        memory[tendons.ANGLE] *= self.pretension / value
        for pairs in (self._pairs, self._first):
            pairs[:, :, tendons.TENSION] += value - self.pretension
        self._settings[tendons.LOW] *= self.pretension / value
        self._settings[tendons.HIGH] *= self.pretension / value
        self.pretension = value
        self._grip()

    def bend(self, friction_angle: float, pretension: float) -> None:
        """Continue at another wrap angle.

        The ratio of the estimated friction coefficient to the modelled one stays, so the estimated x follows the
        modelled one.

        Args:
            friction_angle: x of the model at the new wrap angle, 1.
            pretension: T_p0 of the model at the new wrap angle, N.
        """
        if not (pretension > SLACK * self._model.pretension and friction_angle > 0.0):
            return
        share = friction_angle / self.modelled
        self._memory[tendons.ANGLE] *= share
        self._settings[tendons.LOW] *= share
        self._settings[tendons.HIGH] *= share
        for pairs in (self._pairs, self._first):
            pairs[:, :, tendons.TENSION] += pretension - self.pretension
        self.modelled = friction_angle
        self.pretension = self._modelled_pretension = pretension
        self._grip()

    def _grip(self) -> None:
        tendons.spread(self._pairs, float(self._memory[tendons.ANGLE]), 1.0)

    def pass_over(self, periods: int) -> None:
        """So many periods had no cycle: the motor had their time, too, to reach the speed that it has at the next."""
        self._wait(periods * self._period)

    def _wait(self, seconds: float) -> None:
        self._gap += seconds
        if self._gap > RESTART:
            self.reset()
        elif self._gap > LONGEST_GAP:
            self._lose()

    def update(self, tau_m: float, omega_m: float, q_m: float, q_j: float, fresh: bool = True) -> None:
        """One cycle's measurements, N*m, rad/s and rad; those that are not `fresh` or not finite are passed over."""
        way = self._r_j * q_j
        stretch = self._r_m * q_m - way
        if not fresh or not math.isfinite(stretch + tau_m + omega_m):
            self._wait(self._period)
            return
        elapsed, self._gap = self._period + self._gap, 0.0
        if self._last != self._last:
            self._last, self._omega, self._stretch = way, omega_m, stretch
            self._begin(stretch)
            return
        taken = self._inertia * (omega_m - self._omega) / elapsed
        code, tensions, deviation, near, far, innovation, stiffness, slid = tendons.observe(
            self._pairs,
            self._memory,
            self._settings,
            (tau_m - taken) / self._r_m,
            stretch - self._origin,
            way - self._last,
            (TIME_DOUBT * (stretch - self._stretch) / elapsed) ** 2 + self._misled_by,
        )
        self._last, self._omega, self._stretch = way, omega_m, stretch
        self.innovation, self.stiffness = innovation, stiffness
        if code != tendons.OK or not (near > 0.0 and far > 0.0):  # the corrected state may have no tension
            self._lose()
            self.state = StretchState.SLACK
            return
        self.confirmation.update(innovation, stiffness, slid, self._memory)
        # 0 while all of a tendon slides one way, 1 in the middle of a turn: 1 - z^2 of the friction's state z
        z = math.log(far / near) / self._memory.item(tendons.ANGLE)
        turning = 1.0 - z * z
        if turning < 0.0:
            turning = 0.0
        torque = self._r_j * tensions
        difference = torque - self._per_torque * tau_m
        variance = OF_TENDONS * (self._r_j * deviation) ** 2 + self._noise
        variance += self._bent * difference * difference + self._turn_variance * turning
        self._misled_by = 0.0
        if slid:
            self.state = StretchState.TOLD
            self._misled_by = turning * self._misleads(innovation)
        else:
            self.state = StretchState.UNSLID
            variance += (0.5 * self._friction) ** 2
        half = BAND * math.sqrt(variance)
        self.torque, self.low, self.high = torque, torque - half, torque + half

    def _misleads(self, innovation: float) -> float:
        """m^2 of the next stretch: by how much a course of the bends that is off may foretell it wrongly in a turn."""
        misfit = self._keep_misfit * self._misfit
        self._misfit = misfit = max(abs(innovation), misfit)
        share = (misfit / self._misled) ** 2
        return self._turn_noise / (1.0 + share * share)


def pairs_of(model: TendonSheath) -> Array:
    """The tendons at their pretension, `tendons.PAIRS` times alike, without friction yet."""
    points = np.array(profile_of(model).points, dtype=np.float64)
    rising = points[:, 1] + 1e-12 * np.arange(len(points))  # where the sheath is straight, the place is the farther one
    shares = (np.arange(CONTACTS) + 0.5) / CONTACTS
    places: list[float] = []
    weights: list[float] = []
    for place in np.interp(shares, rising, points[:, 0]).tolist():
        if places and place - places[-1] < NEAR:
            weights[-1] += 1.0 / CONTACTS
        else:
            places.append(place)
            weights.append(1.0 / CONTACTS)
    length = model.unstrained_length
    lengths = np.diff(np.array([0.0, *places, 1.0])) * length
    lengths[-1 if model.series_at_joint else 0] += model.series_length
    whole = lengths.sum()
    lengths = np.maximum(lengths, NEAR * length)
    lengths *= whole / lengths.sum()
    pairs = np.zeros((tendons.PAIRS, 2, tendons.ROWS, len(places) + 1))
    pairs[:, :, tendons.STIFFNESS] = model.axial_stiffness / lengths
    pairs[:, :, tendons.TENSION] = model.pretension
    pairs[:, :, tendons.SHARE, : len(places)] = weights
    return pairs


def _hidden(model: TendonSheath, centre: float) -> float:
    """m of stretch that friction can hide, either way, at a motor without torque; `centre` of the bends, 1."""
    return centre * model.friction_angle * (model.pretension / model.tendon_stiffness)


def _settings(model: TendonSheath, period: float, counts: tuple[float, float], centre: float) -> Array:
    """Return the constants of the filter; `counts` in m of the two pulleys, `centre` of the bends, 1."""
    x, stretched = model.friction_angle, model.pretension / model.tendon_stiffness
    told = np.zeros(tendons.SETTINGS)
    told[tendons.LOW], told[tendons.HIGH] = x / FACTOR, FACTOR * x
    told[tendons.MOST_ZERO] = stretched
    keep = math.exp(-period / PASSING_TIME)
    hidden = _hidden(model, centre)
    told[tendons.MOST_STIFF] = STIFF_FACTOR
    prior = {tendons.X: FRICTION_PRIOR, tendons.F: PASSING, tendons.Z: hidden}
    walk = {tendons.X: FRICTION_WALK, tendons.Z: ZERO_WALK, tendons.K: STIFF_WALK}
    prior[tendons.K] = model.axial_stiffness_uncertainty / BAND
    for state in range(tendons.STATES):
        told[tendons.PRIOR + state] = prior[state] ** 2
        told[tendons.WALK + state] = walk.get(state, 0.0) ** 2 * period
    told[tendons.WALK + tendons.F] = (1.0 - keep * keep) * PASSING**2
    told[tendons.KEEP_F] = keep
    torque = 0.5 * TORQUE_NOISE / model.motor_pulley_radius / model.tendon_stiffness
    told[tendons.NOISE] = ALIKE * (COUNTS * (counts[0] ** 2 + counts[1] ** 2) / 12.0 + torque**2)
    told[tendons.LEAST] = SLACK * model.pretension
    told[tendons.SETTLED] = SURELY * hidden
    return told
