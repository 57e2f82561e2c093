"""A test bench: a random rig with one or several runs, drawn according to a recipe."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from . import memory
from .motion import Motion, grid, held_levels, one_way, plain_motion, rich_motion, smoothed, torque_programme, wander
from .plant import Effects, Scene, Tensions, simulate
from .rig import Rig, draw_nominal, draw_rig

Array = np.ndarray
MEMORY = {"presliding_hysteresis", "backlash", "transport_delay"}
Disturbance = Callable[["Bench", "Run", Array], Array]


@dataclass(frozen=True)
class Recipe:
    """The excitation of the rig and the recorded signals. None and an empty string mean a random choice."""

    motion: str = "rich"  # "rich", "one_way" or a kind of motion.KINDS
    torque: str = ""  # "independent", "levels", "one_sign", "loaded", "spring", "free", "weight", "one_load"
    amplitude: float | None = None  # rad
    speed: float | None = None  # rad/s, for plain motions
    rounding: float = 0.0  # s, rounding of the corners of a plain motion
    level: tuple[float, float] = (0.4, 0.85)  # peak motor torque as a share of the slack limit
    bending: str = "fixed"  # "fixed", "varied" (known, in column theta)
    temperature: str = ""  # "cycle", "warm_up", "none"
    motor_angle: bool | None = None
    joint_angle: bool | None = None
    velocity: str = ""  # "tachometer", "encoder", "derived" (only q_j is recorded)
    seconds: tuple[float, float] = (25.0, 60.0)
    runs: int = 0  # 0: random, one to four
    rate: int = 0
    x: tuple[float, float] = (0.12, 0.9)
    sign_noise: float = 2.0  # largest torque error by wrong velocity signs, as a multiple of the torque noise
    velocity_noise: float | None = None  # rad/s RMS of a tachometer; None: a share of the peak speed
    blind: bool = False  # the temperature changes but is not recorded
    bare: bool = False  # only the columns that the recipe requires
    short: bool = False  # the quick gate: 12 to 20 s, one run


@dataclass
class Run:
    """One run: the scene on the fine grid and the subset of samples that the log contains."""

    scene: Scene
    every: int
    rate: float
    motion: Motion
    _plain: Array | None = None

    def pick(self, values: Array) -> Array:
        return values[self.scene.first :: self.every]

    @cached_property
    def sparse(self) -> Scene:
        """Return the scene at the log's samples only, which suffices for effects without memory."""
        s = self.scene
        t, q, omega, acceleration, q_m, tau_m, theta, temperature = (
            self.pick(c) for c in (s.t, s.q, s.omega, s.acceleration, s.q_m, s.tau_m, s.theta, s.temperature)
        )
        friction, pretension = (None if f is None else self.pick(f) for f in (s.friction_scale, s.pretension_scale))
        sigma = self.pick(s.direction())
        return Scene(t, q, omega, acceleration, q_m, tau_m, theta, temperature, 0, sigma, friction, pretension)

    def plain(self, rig: Rig, motor_angle: bool) -> Array:
        """Return the joint torque (N*m) without effects on the fine grid.

        The result is cached, because a disturbance is tested at several strengths.
        """
        if self._plain is None:
            self._plain = simulate(rig, self.scene, {}, motor_angle).joint_torque
        return self._plain

    def simulate(self, rig: Rig, effects: Effects, motor_angle: bool) -> Tensions:
        """Return tensions (N) and joint torque (N*m) at the log's samples."""
        if not MEMORY & effects.keys():
            return simulate(rig, self.sparse, effects, motor_angle)
        fine = simulate(rig, self.scene, effects, motor_angle)
        return Tensions(*(self.pick(c) for c in (fine.t1, fine.t2, fine.t3, fine.t4, fine.joint_torque)))


@dataclass
class Bench:
    """The rig with its runs, and the properties of the instruments for all runs."""

    rig: Rig
    nominal: Rig
    runs: list[Run]
    recipe: Recipe
    motor_angle: bool
    joint_angle: bool
    velocity: str
    temperature: bool
    counts: int
    window: float  # s, over which the drive differentiates its encoder signal
    extras: tuple[str, ...] = ()
    clock_start: float = 0.0
    scale: float = 0.0  # RMS of the joint torque without effects, N·m

    def ideal(self, effects: Effects) -> list[Array]:
        """Return the noise-free joint torque (N*m) of every run at its log's samples."""
        return [run.simulate(self.rig, effects, self.motor_angle).joint_torque for run in self.runs]

    def ideal_as_seen(self, effects: Effects, log_effects: Effects) -> list[Array]:
        """Return `ideal(effects)` with sigma from the velocity as it is logged under `log_effects`."""
        torques = []
        for run in self.runs:
            sigma = memory.direction(self.seen_velocity(run, log_effects))
            seen = Run(replace(run.scene, sigma=sigma), run.every, run.rate, run.motion)
            torques.append(seen.simulate(self.rig, effects, self.motor_angle).joint_torque)
        return torques

    def disturbed(self, disturb: Disturbance) -> list[Array]:
        """Return the noise-free joint torque (N*m) of every run with a disturbance instead of effects."""
        torques = []
        for run in self.runs:
            torques.append(run.pick(disturb(self, run, run.plain(self.rig, self.motor_angle))))
        return torques

    def slack_share(self, effects: Effects) -> float:
        """Return the share of all samples in which the force of a tendon at the motor would be negative."""
        all_tensions = [run.simulate(self.rig, effects, self.motor_angle) for run in self.runs]
        return float(np.mean(np.concatenate([(each.t1 < 0.0) | (each.t3 < 0.0) for each in all_tensions])))

    def seen_velocity(self, run: Run, effects: Effects) -> Array:
        """Return the noise-free velocity (rad/s) of the log on the fine grid."""
        lag = effects.get("velocity_lag", {}).get("time_constant", 0.0)
        if lag == 0.0:
            return run.scene.omega
        return memory.first_order_lag(run.scene.omega, run.scene.t[1] - run.scene.t[0], lag)

    @property
    def reading(self) -> float:
        """Return the design range of the torque sensor (N*m): the larger of RMS joint torque and friction torque."""
        half_loop = 2.0 * self.rig.pretension * self.rig.joint_radius * float(np.sinh(self.rig.x))
        return max(self.scale, half_loop)

    @property
    def speed(self) -> float:
        return max(run.motion.speed for run in self.runs)

    @property
    def reach(self) -> float:
        """Return half the range of the joint angle, rad."""
        return 0.5 * max(float(np.ptp(run.scene.q)) for run in self.runs)

    @property
    def motor_reach(self) -> float:
        return 0.5 * max(float(np.ptp(run.scene.q_m)) for run in self.runs)


def draw_bench(rng: np.random.Generator, recipe: Recipe, like: Bench | None = None) -> Bench:
    """Return a rig with its runs, without effects and noise.

    If `like` is given, the rig and its nominal model are taken from that bench.
    """
    rig = draw_rig(rng, recipe.x) if like is None else like.rig
    nominal = draw_nominal(rng, rig) if like is None else like.nominal
    count = 1 if recipe.short else recipe.runs or int(rng.choice([1, 1, 1, 2, 3, 4]))
    rate = recipe.rate or int(rng.choice([200, 250, 500, 500, 1000]))
    if recipe.short:
        rate = min(rate, 500)
    every = {200: 20, 250: 16, 500: 9, 1000: 4}.get(rate, max(2, round(4000 / rate)))
    velocity = recipe.velocity or str(rng.choice(["tachometer", "encoder", "derived"], p=[0.45, 0.35, 0.2]))
    joint_angle = velocity == "derived" or (
        bool(rng.random() < 0.7) if recipe.joint_angle is None else recipe.joint_angle
    )
    motor_angle = bool(rng.random() < 0.45) if recipe.motor_angle is None else recipe.motor_angle
    temperature = recipe.temperature or str(rng.choice(["none", "none", "cycle", "warm_up"]))
    extras = tuple(
        name for name, share in (("omega_m", 0.2), ("tensions", 0.08), ("tau_m_cmd", 0.1)) if rng.random() < share
    )
    if recipe.bare:
        extras, motor_angle = (), bool(recipe.motor_angle)
    runs = []
    low, high = (12.0, 20.0) if recipe.short else recipe.seconds
    for _ in range(count):
        seconds = rng.uniform(low, high) / (1.0 if count < 3 else 1.5)
        runs.append(_draw_run(rng, recipe, rig, nominal, seconds, rate, every, velocity, temperature))
    bench = Bench(
        rig=rig,
        nominal=nominal,
        runs=runs,
        recipe=recipe,
        motor_angle=motor_angle,
        joint_angle=joint_angle,
        velocity=velocity,
        temperature=temperature != "none" and not recipe.blind,
        counts=2 ** int(rng.integers(15, 19)),
        window=rng.uniform(0.006, 0.014),
        extras=extras,
        clock_start=float(rng.choice([0.0, 0.0, 0.0, round(rng.uniform(1.0, 4000.0), 3)])),
    )
    bench.scale = rms(np.concatenate(bench.ideal({})))
    return bench


def rms(values: Array) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def _draw_run(
    rng: np.random.Generator,
    recipe: Recipe,
    rig: Rig,
    nominal: Rig,
    seconds: float,
    rate: int,
    every: int,
    velocity: str,
    temperature: str,
) -> Run:
    fine = float(rate * every)
    t = grid(seconds, fine, before=0.25)
    motion = _draw_motion(rng, recipe, t, velocity)
    theta = np.full_like(t, rig.bending)
    if recipe.bending == "varied":
        swing = min(0.35 * rig.bending, 0.4 * rig.pretension / rig.tension_per_bending)
        theta = theta + swing * wander(rng, t, seconds / rng.uniform(1.2, 2.5))
    tau_m = _draw_torque(rng, recipe, rig, nominal, motion, theta)
    wind_up = tau_m / (2.0 * rig.motor_radius**2 * rig.tendon_stiffness)
    ratio = rig.joint_radius / rig.motor_radius
    wind_up *= min(1.0, 0.15 * ratio * float(np.ptp(motion.q)) / max(float(np.ptp(wind_up)), 1e-12))
    scene = Scene(
        t=t,
        q=motion.q,
        omega=motion.omega,
        acceleration=motion.acceleration,
        q_m=ratio * motion.q + wind_up,
        tau_m=tau_m,
        theta=theta,
        temperature=_draw_temperature(rng, temperature, t),
        first=round(0.25 * fine),
    )
    return Run(scene, every, float(rate), motion)


def _draw_motion(rng: np.random.Generator, recipe: Recipe, t: Array, velocity: str) -> Motion:
    if recipe.motion == "rich":
        # The joint rests only if the counts of its encoder rest as well.
        return rich_motion(rng, t, recipe.amplitude, dwell=velocity == "encoder" and rng.random() < 0.3)
    if recipe.motion == "one_way":
        fast = recipe.speed or rng.uniform(0.5, 3.0)
        return one_way(rng, t, (0.2 * fast, fast))
    amplitude = recipe.amplitude or rng.uniform(0.4, 1.3)
    speed = recipe.speed or amplitude * rng.uniform(0.8, 4.0)
    return plain_motion(rng, t, recipe.motion, amplitude, speed, recipe.rounding)


def _draw_torque(
    rng: np.random.Generator, recipe: Recipe, rig: Rig, nominal: Rig, motion: Motion, theta: Array
) -> Array:
    """Return the motor torque (N*m), whose reported and acting values are equal.

    `recipe.level` limits it relative to the torque at which one tendon goes slack.
    """
    kind = recipe.torque or str(rng.choice(["independent", "levels", "loaded"], p=[0.5, 0.25, 0.25]))
    pretension = rig.pretension + rig.tension_per_bending * (theta - rig.bending)
    limit = 2.0 * float(np.min(pretension)) * rig.motor_radius
    level = rng.uniform(*recipe.level)
    t, step = motion.t, motion.t[1] - motion.t[0]
    if kind == "independent":
        return level * limit * torque_programme(rng, t)
    if kind == "one_sign":
        return level * limit * torque_programme(rng, t, sign=int(rng.choice([-1, 1])))
    if kind == "one_load":  # far from zero, so that friction never reverses the sign of the joint torque
        least = np.tanh(float(np.max(rig.mu * theta))) + 0.08
        share = np.abs(torque_programme(rng, t, sign=1))
        return float(rng.choice([-1.0, 1.0])) * limit * (least + max(level - least, 0.15) * share)
    if kind == "levels":
        return level * limit * held_levels(rng, t, rng.uniform(2.0, 6.0))
    # The joint carries a load, and a controller with the nominal values compensates the friction.
    load = _draw_load(rng, kind, motion)
    x, sigma = nominal.mu * theta, memory.direction(motion.omega)
    compensation = nominal.motor_radius * 2.0 * nominal.pretension / rig.pretension * pretension * sigma * np.tanh(x)
    compensation = smoothed(compensation, rng.uniform(0.006, 0.02) / step)
    room = level * limit - float(np.max(np.abs(compensation)))
    if kind == "loaded" and room < 0.25 * limit:  # friction takes the whole torque, so the log would be uninformative
        return level * limit * torque_programme(rng, t)
    room = max(room, 0.12 * limit)
    tau_m = compensation + room * load
    return tau_m * min(1.0, 0.92 * limit / float(np.max(np.abs(tau_m))))


def _draw_load(rng: np.random.Generator, kind: str, motion: Motion) -> Array:
    """Return the load torque with a peak of 1, or of at most 0.03 if the joint is free."""
    q, omega = motion.q, motion.omega / motion.speed
    spring = q / np.max(np.abs(q))
    weight = np.sin(q + rng.uniform(0.4, 1.2))
    match kind:
        case "spring":
            load = spring
        case "weight":
            load = weight
        case "free":
            load = 0.03 * spring
        case "loaded":
            share = rng.uniform(0.0, 0.5, 3)
            load = share[0] * spring + share[1] * weight + share[2] * omega + torque_programme(rng, motion.t)
        case _:
            raise ValueError(f"unknown kind of torque: {kind}")
    return load / max(1.0, float(np.max(np.abs(load)))) if kind == "free" else load / float(np.max(np.abs(load)))


def _draw_temperature(rng: np.random.Generator, kind: str, t: Array) -> Array:
    seconds = t[-1]
    room = rng.uniform(18.0, 30.0)
    match kind:
        case "cycle":  # heated and cooled
            return room + rng.uniform(5.0, 15.0) * (1.0 + wander(rng, t, seconds / rng.uniform(1.0, 2.0)))
        case "warm_up":
            return room + rng.uniform(3.0, 20.0) * -np.expm1(-(t - t[0]) / (seconds * rng.uniform(0.2, 0.8)))
        case _:
            return np.full_like(t, room)
