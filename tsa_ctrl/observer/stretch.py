"""Estimate the joint torque on-line from two encoders and the motor torque, with a 95 % band.

No torque sensor and no known load are required. The tendons are simulated contact by contact (`tendons`). Inputs are
the motor torque minus its acceleration torque, tau_M - J_M alpha_M, and the joint angle. The simulation predicts the
elongation s = r_M q_M - r_J q_J. A difference from the measured s is an error of the friction or the stiffness, or a
drift of the zero of s. An extended Kalman filter separates them: ln x, the stiffness and the zero drift slowly, and a
fourth state is temporary friction.

While the tendons slide, the estimate is the line of `tsa_ctrl.model.stretch`. During a reversal that line has an error
of up to half the friction, and the slip fronts determine the estimate.

x means x T_p here, because only the product is identifiable. Friction and pretension may therefore be unknown.
The stiffness must be known within its [uncertainty]: it is the inverse of the slope of s over tau_M while all tendons
slide, for any friction. The curvature profile must be known: the band includes [uncertainty] bending_centre.
During a reversal the band also includes an error of the profile itself, which is larger if the file has only the
centre of the bends.

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
# Number of successive deviating cycles after which the torque is no longer confirmed. In each cycle the observer
# changes its friction by a twentieth at most. After 10 cycles it has therefore followed a friction error of one
# standard deviation of the prior. At 1 kHz, healthy rigs show at most four such cycles in a row.
LASTING = 10


class Confirmation:
    """Compare the innovations of the elongation observer with their uncertainty, to confirm the reported motor torque.

    `confirmed`: True until the elongation deviates from its prediction in `LASTING` successive cycles; True again
    after a reset.
    """

    def __init__(self, model: TendonSheath, noise: float, period: float) -> None:
        """Prepare the test; `noise`: m^2 of one measured elongation; `period`: s."""
        self._uncertainty = model.axial_stiffness_uncertainty  # 1, of ln k
        self._stiffest = math.exp(self._uncertainty)
        self._softest = 1.0 / self._stiffest
        self._noise = float(noise)
        self._least = MISFIT**2 * self._noise  # m^2: the variance is never less than the noise
        self._share = 1.0 - math.exp(-period / SMOOTH)
        self.reset()

    def reset(self) -> None:
        """Discard the history and confirm the torque again."""
        self.confirmed = True
        self._innovation = 0.0  # m
        self._beyond = 0  # cycles in a row

    def update(self, innovation: float, stiff: float, slid: bool, memory: Array) -> None:
        """Compare the innovation (m) with its standard deviation, and the stiffness (1) with the bounds of the file.

        Args:
            innovation, stiff, slid: results of `tendons.observe`.
            memory: the state of `tendons`, which includes the uncertainty of its states.
        """
        self._innovation += self._share * (innovation - self._innovation)
        if not self.confirmed:
            return
        squared = self._innovation**2
        if squared <= self._least and self._softest <= stiff <= self._stiffest:  # within the noise
            self._beyond = 0
            return
        if not slid:
            return
        by_x, by_k = float(memory[tendons.GAIN_S]), float(memory[tendons.GAIN_S + 1])
        x, k, passing, zero = memory[tendons.COVARIANCE :: tendons.STATES + 1].tolist()
        variance = by_x * by_x * (x + passing) + by_k * by_k * k + zero + self._noise
        off = abs(math.log(stiff)) > self._uncertainty + MISFIT * math.sqrt(k)
        self._beyond = self._beyond + 1 if off or squared > MISFIT**2 * variance else 0
        self.confirmed = self._beyond < LASTING


CONTACTS = 12  # per tendon; 6 are 1 mN*m worse on the shipped actuator, 24 are no better and take twice as long
NEAR = 1e-3  # of the length: closer bends are one contact, and no spring is shorter; x does not resolve this length
FRICTION_PRIOR = 0.5  # 1, standard deviation of ln x at startup, and its upper limit afterwards
FRICTION_WALK = 0.07  # 1/sqrt(s), random walk of ln x: a change of 40 % within 10 s is 1.5 standard deviations
PASSING, PASSING_TIME = 0.015, 0.05  # share of x and s: temporary friction; a larger share hides the stiffness
ZERO_WALK = 0.3e-6  # m/sqrt(s), random walk of the zero by creep and temperature: 20 um in 75 minutes
FACTOR = 4.0  # x stays within the file's value divided and multiplied by this factor
STIFF_WALK = 1e-4  # 1/sqrt(s), random walk of ln k: a tendon that softens by 1 % in an hour
# Multiple of the elongation that friction can hide. The model's tendons start with equal tensions along their length.
# When they slide, real tendons with the opposite previous load and 1.5 times the friction still need twice that
# elongation. After a reversal, half that elongation is enough for friction that is a quarter higher.
SURELY = 2.0
NEARLY = 0.99  # share of a bound that counts as reached, because the filter stops close to it
STIFF_FACTOR = 1.5  # bound of the stiffness over the file's value, and of the inverse; beyond it, the tendon is another
TORQUE_NOISE = 2e-3  # N*m at the motor, standard deviation of the reported torque, as of the simulated drive
# s, uncertainty of the delay between torque and angles while the elongation changes: half of a current loop's delay.
# The motion of a trembling hand consists only of reversals. Without this term, the filter would learn a wrong stiffness
# from them.
TIME_DOUBT = 0.3e-3
COUNTS = 6.0  # times the variance of a count: during slow motion its error is the same in successive cycles
# Factor of the variance of a measured elongation, because errors of the tendon model are correlated in time. With 100,
# the joint receives 50 mJ before a loss of pretension is detected. With 20, a wrong stiffness causes an error of 3.4 %
# of a held torque.
ALIKE = 28.0
SLACK = 0.02  # 1, of the pretension, below which a tendon counts as slack
LONGEST_GAP = 0.05  # s without measurements after which the positions of the slip fronts are unknown
RESTART = 1.0  # s without measurements after which an encoder may have restarted: a restart takes longer
BAND = 1.96  # standard deviations of 95 %
# Share of the filter's variance of the tendons that the band includes. The filter assumes more drift and temporary
# friction than tendons show, so that it follows a change of 40 % within 10 s. With all of that variance the band would
# be three times as wide as necessary. With this share and `TOLD` the band contains 95 to 97 % of the samples of
# simulated rigs on average (tools/run bench/stretch). Single rigs differ, because the residual is not noise. Before the
# tendons have slid in both directions, friction, stiffness and zero are not separately identifiable, and the band
# includes all of the variance.
OF_TENDONS = 0.035
SLIDES = 0.9  # friction state z, beyond which the tendons slide in one direction
# 1, error over the friction torque in the middle of a reversal, if the file has only the centre of the bends. Two bends
# with a straight piece between them change the slip fronts by this much (5.3 % RMS over the reversal).
COURSE = 0.06
TOLD = 0.01  # 1, the same if the file has the curvature profile that tsa calibrate --stretch determines
# 1, standard deviation in the middle of a reversal over the elongation that friction can hide. A wrong profile causes
# the same error in all samples of a reversal, so they count like a single sample with an error of some percent.
# With the noise of single samples, each reversal of a locked joint leaves a friction error of 2 %, and twice the torque
# error.
TURN_DOUBT = 1.0
# Share of the elongation that friction can hide, and s. On simulated rigs with a calibrated file, a wrong profile
# causes no larger error than this in addition to the noise. A larger innovation within that time shows an error of
# friction or stiffness, and reversals then correct the states with more weight. A file with a friction error of 24 %
# needs this: without it, the stiffness is 1.5 times too high after the first strokes.
MISLED, MISLED_FOR = 0.05, 1.0


class StretchState(Enum):
    """List the states of the estimate; the values are the codes in the log."""

    NONE = 0  # fewer than two encoders, or a profile for which the elongation determines nothing
    UNSLID = 1  # the tendons have not slid along their whole length yet: the band includes the possible friction
    ESTIMATED = 2
    SLACK = 3  # a tendon is slack, or the motor torque is outside the model's domain: no torque is reported


class StretchObserver:
    """Estimate the joint torque; a cycle takes a few microseconds.

    Attributes: `torque`, `low`, `high`: N*m at the joint, nan while it cannot be estimated. `stiffness`: 1, stiffness
    of the tendons (and of a series spring) over the model file's. `innovation`: m, measured minus predicted elongation
    of the last cycle.
    """

    def __init__(
        self, model: TendonSheath, period: float, counts: tuple[float, float], motor_inertia: float = 0.0
    ) -> None:
        """Prepare the tendons and the filter.

        Args:
            model: friction angle and pretension must be above 0.
            period: s.
            counts: rad of one count at the motor's and the joint's pulley.
            motor_inertia: J_M in kg*m^2.

        Raises:
            UsageError: friction angle or pretension is not above 0, or `stretch_line` rejects the model.
        """
        if not (model.friction_angle > 0.0 and model.pretension > 0.0):
            raise UsageError(
                f"{model.source or 'model'}: friction angle {model.friction_angle:g} and pretension "
                f"{model.pretension:g} N: both must be above 0 to track the tendon elongation"
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
        self._friction = 2.0 * r_j * model.pretension * model.friction_angle  # N*m, half the hysteresis width
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
        self._modelled_pretension = model.pretension  # N, of the model at that wrap angle
        self.most_friction_angle = model.most_friction * model.friction_angle  # 1, at the file's pretension
        tendons.observe(self._pairs, self._memory + 1.0, self._settings, 0.0, 0.0, 0.0, 0.0)  # compiles
        self.reset()

    def reset(self) -> None:
        """Reset all states and the zero of s; the next measurement sets the zero again."""
        self._gap = 0.0
        self._slid_forward = self._slid_backward = False
        self.confirmation.reset()
        self._origin = math.nan  # m, elongation at the first measurement; the zero is relative to it
        self._memory[:] = 0.0
        settings, memory = self._settings, self._memory
        memory[tendons.ANGLE] = self.modelled * self._modelled_pretension / self.pretension
        memory[tendons.STIFF] = self.stiffness = 1.0
        self.innovation = 0.0
        for state in range(tendons.STATES):
            memory[tendons.COVARIANCE + (tendons.STATES + 1) * state] = settings[tendons.PRIOR + state]
        self._lose()

    def _lose(self) -> None:
        """Discard the positions of the slip fronts; keep the estimates of friction, stiffness and zero."""
        self.state = StretchState.UNSLID
        self.torque = self.low = self.high = math.nan
        self._last = math.nan  # m, last position of the joint pulley
        self._omega = self._stretch = math.nan
        self._misfit = self._misled_by = 0.0  # m, the largest recent innovation; m^2, see `_misleads`

    def _begin(self, stretch: float) -> None:
        """Set tensions that are equal along each tendon and match the measured elongation `stretch` (m)."""
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
        """Return x (1) at `pretension`; the elongation determines only the product of both."""
        return float(self._memory[tendons.ANGLE])

    @property
    def friction_deviation(self) -> float:
        """Return the standard deviation of ln x."""
        return math.sqrt(max(0.0, float(self._memory[tendons.COVARIANCE])))

    @property
    def stiffness_deviation(self) -> float:
        """Return the standard deviation of the logarithm of the stiffness."""
        place = tendons.COVARIANCE + (tendons.STATES + 1) * tendons.K
        return math.sqrt(max(0.0, float(self._memory[place])))

    @property
    def at_bound(self) -> bool:
        """Return True if stiffness or friction has reached a bound; the tendons then probably differ from the file."""
        memory, told = self._memory, self._settings
        stiff, x, most = memory[tendons.STIFF], memory[tendons.ANGLE], told[tendons.MOST_STIFF]
        inside = 1.0 / most < NEARLY * stiff and stiff < NEARLY * most
        return not (inside and told[tendons.LOW] < NEARLY * x and x < NEARLY * told[tendons.HIGH])

    @property
    def zero(self) -> float:
        """Return the zero of the elongation: the value of s (m) without elongation."""
        return self._origin + float(self._memory[tendons.ZERO])

    def set_pretension(self, value: float) -> None:
        """Continue with another T_p0 (N), and scale the friction angle so that their product stays the same."""
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

        The ratio of the estimated to the modelled friction coefficient stays constant, so the estimated x follows the
        modelled x.

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

    def skip_cycles(self, periods: int) -> None:
        """Account for `periods` without a cycle; the next acceleration is averaged over that time as well."""
        self._wait(periods * self._period)

    def _wait(self, seconds: float) -> None:
        self._gap += seconds
        if self._gap > RESTART:
            self.reset()
        elif self._gap > LONGEST_GAP:
            self._lose()

    def update(self, tau_m: float, omega_m: float, q_m: float, q_j: float, fresh: bool = True) -> None:
        """Process the measurements of one cycle (N*m, rad/s, rad); ignore those that are not `fresh` or not finite."""
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
        if code != tendons.OK or not (near > 0.0 and far > 0.0):  # the corrected tensions may be negative
            self._lose()
            self.state = StretchState.SLACK
            return
        self.confirmation.update(innovation, stiffness, slid, self._memory)
        # 1 - z^2 with the friction state z: 0 while the whole tendon slides in one direction, 1 in the middle of a
        # reversal
        z = math.log(far / near) / self._memory.item(tendons.ANGLE)
        turning = 1.0 - z * z
        if turning < 0.0:
            turning = 0.0
        torque = self._r_j * tensions
        difference = torque - self._per_torque * tau_m
        if slid and z > SLIDES:
            self._slid_forward = True
        elif slid and z < -SLIDES:
            self._slid_backward = True
        share = OF_TENDONS if self._slid_forward and self._slid_backward else 1.0
        variance = share * (self._r_j * deviation) ** 2 + self._noise
        variance += self._bent * difference * difference + self._turn_variance * turning
        self._misled_by = 0.0
        if slid:
            self.state = StretchState.ESTIMATED
            self._misled_by = turning * self._misleads(innovation)
        else:
            self.state = StretchState.UNSLID
            variance += (0.5 * self._friction) ** 2
        half = BAND * math.sqrt(variance)
        self.torque, self.low, self.high = torque, torque - half, torque + half

    def _misleads(self, innovation: float) -> float:
        """Return the variance (m^2) that a wrong curvature profile adds to the next predicted elongation.

        The value is for the middle of a reversal. It falls when the recent innovations exceed `MISLED`.
        """
        misfit = self._keep_misfit * self._misfit
        self._misfit = misfit = max(abs(innovation), misfit)
        share = (misfit / self._misled) ** 2
        return self._turn_noise / (1.0 + share * share)


def pairs_of(model: TendonSheath) -> Array:
    """Return `tendons.PAIRS` equal pairs of tendons at their pretension, (PAIRS, 2, ROWS, N + 1); GRIP is not set."""
    points = np.array(profile_of(model).points, dtype=np.float64)
    rising = points[:, 1] + 1e-12 * np.arange(len(points))  # strictly increasing, as the interpolation requires
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
    """Return the elongation (m) that friction can hide in either direction without motor torque.

    `centre`: centre of the bends, 1.
    """
    return centre * model.friction_angle * (model.pretension / model.tendon_stiffness)


def _settings(model: TendonSheath, period: float, counts: tuple[float, float], centre: float) -> Array:
    """Return the constants of the filter; `counts`: m at the two pulleys; `centre`: centre of the bends, 1."""
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
