"""Create cases: logs with hidden effects. Family, name and seed determine a case completely."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from .bench import Bench, Recipe, draw_bench
from .outside import STRANGERS, CatalogueSpan
from .recording import HiddenLog, record
from .rig import log_uniform, model_file
from .rivals import is_unique
from .size import added_size, size
from .strength import NAMES, Strength, draw_strength, solve


@dataclass
class Truth:
    """The hidden effects. Sizes are RMS values in N·m after recalibration. `noise` is the RMS of the torque noise."""

    effects: dict[str, dict[str, Any]]
    noise: float = 0.0
    sign_noise: float = 0.0  # RMS of the torque error by wrong signs of the recorded velocity
    size: float = 0.0
    sizes: dict[str, float] = field(default_factory=dict)  # size of each effect in the presence of the others
    outside: str = ""  # kind of cause outside the catalogue
    twins: tuple[str, ...] = ()  # effects that no diagnosis can distinguish in this case, including the truth
    exact: bool = True  # False: the effects differ a little, so the true name alone is also right
    numbers: dict[str, float] = field(default_factory=dict)  # true friction_angle, pretension, slope, half_loop_torque
    setting: str = ""  # description of the excitation


@dataclass
class Case:
    """Logs and nominal model for a diagnosis, and the hidden truth to mark its result."""

    family: str
    name: str
    seed: int
    logs: list[HiddenLog]
    model: str  # text of an actuator model file
    truth: Truth
    experiment: Case | None = None  # logs of the same rig that separate the indistinguishable effects
    bench: Bench | None = field(default=None, repr=False)  # source of the logs, used for the marking

    @property
    def key(self) -> str:
        return f"{self.family}/{self.name}/{self.seed}"

    @property
    def seconds(self) -> float:
        return float(sum(np.ptp(log.columns["t"]) for log in self.logs))


def generator(family: str, name: str, seed: int, attempt: int = 0) -> np.random.Generator:
    digest = hashlib.sha256(f"{family}/{name}/{seed}/{attempt}".encode()).digest()
    return np.random.default_rng(int.from_bytes(digest[:8], "little"))


# Requirements of an effect that make it distinguishable: columns, and excitation outside the table of twins.
NEEDS: dict[str, dict[str, Any]] = {
    "velocity_lag": {"velocity": "tachometer", "sign_noise": 0.7},
    "torque_constant_error": {"bending": "varied"},
    "torque_ripple": {"motor_angle": True, "torque": "independent"},
    "motor_side_friction": {"bending": "varied"},
    "configuration_dependent_bending": {"joint_angle": True, "amplitude": 1.2, "level": (0.3, 0.6)},
    "stiffness_nonlinearity": {"bending": "varied", "level": (0.2, 0.5)},
    # unrecorded temperature would be indistinguishable
    "pretension_relaxation": {"level": (0.2, 0.4), "temperature": "cycle"},
    "thermal_friction_drift": {"temperature": "cycle"},
    "tension_dependent_friction": {"x": (0.2, 0.9), "level": (0.7, 0.95), "torque": "independent"},
    "presliding_hysteresis": {"joint_angle": True, "sign_noise": 0.7},
    "transport_delay": {"sign_noise": 0.7},
    "sheath_asymmetry": {"torque": "independent"},
    "tendon_slack": {"torque": "independent", "level": (1.15, 1.9), "x": (0.2, 0.9)},
    "elongation_coupling": {"bending": "varied", "x": (0.4, 0.9)},
    "load_dependent_friction": {"torque": "independent", "x": (0.12, 0.35), "level": (0.65, 0.9)},
    "backlash": {"joint_angle": True, "sign_noise": 0.7},
    "pulley_eccentricity": {"joint_angle": True, "torque": "independent", "amplitude": 1.5},
    "gravity_load": {"joint_angle": True, "amplitude": 1.5},
    "joint_stiffness": {"joint_angle": True, "amplitude": 1.1},
    "stribeck_friction": {},
    "torque_saturation": {"torque": "independent", "level": (0.6, 0.9)},
    "torque_sensor_lag": {"sign_noise": 0.7, "torque": "independent"},
}

# Effects of the pairs. Later effects are excluded, so that the same seeds keep giving the same random trials.
LATER = ("pulley_eccentricity", "torque_saturation", "torque_sensor_lag")
PAIRED = tuple(name for name in NAMES if name not in LATER)

# Rows of indistinguishable effects: two effects of one row do not form a pair.
TWIN_ROWS = (
    {"elongation_coupling", "torque_constant_error"},
    {"inertia", "joint_stiffness", "torque_offset"},
    {"gravity_load", "joint_stiffness", "torque_offset"},
    {"viscous_friction", "direction_asymmetric_friction"},
    {"direction_asymmetric_friction", "torque_offset"},
    {"viscous_friction", "motor_side_friction"},
    {"load_dependent_friction", "sheath_asymmetry", "tendon_slack", "tension_dependent_friction"},
    {"thermal_friction_drift", "pretension_relaxation"},
    {"transport_delay", "presliding_hysteresis", "velocity_lag", "backlash"},
    {"elongation_coupling", "tendon_slack"},
    {"elongation_coupling", "sheath_asymmetry"},
    {"elongation_coupling", "tension_dependent_friction"},
)

HIDDEN_DIRECTION = ("slow_gait", "slow_multisine", "slow_walk", "plateaus")
TACHOMETER_NOISE = 0.012  # rad/s; with it, 4 of 24 logs of slow motion without an effect were classified as structure
POOR = ("slow_sine", "one_way", "constant_speed", "free", "small", "one_load")


def none_case(name: str, seed: int, short: bool = False, like: Bench | None = None) -> Case:
    """Return a case without effect. Its nominal values are wrong and its signals have noise.

    `name` is "rich...", "plain" or an uninformative excitation. If `like` is given, the rig of that bench is used.
    """
    rng = generator("none", name, seed)
    if name.startswith("rich"):
        recipe = Recipe(bending=str(rng.choice(["fixed", "fixed", "varied"])), sign_noise=8.0)
    elif name == "plain":
        recipe = Recipe(
            motion=str(rng.choice(["sine", "multisine", "trapezoid", "chirp", "gait", "triangle"])), sign_noise=8.0
        )
    else:
        recipe = {
            "slow_sine": Recipe(motion="sine", speed=0.15, amplitude=0.8, torque="spring", sign_noise=8.0),
            "one_way": Recipe(motion="one_way", sign_noise=8.0),
            "constant_speed": Recipe(motion="triangle", torque="levels", sign_noise=8.0),
            "free": Recipe(torque="free", sign_noise=8.0),
            "small": Recipe(motion="multisine", amplitude=0.03, speed=0.15, sign_noise=8.0),
            "one_load": Recipe(motion="sine", torque="weight", sign_noise=8.0),
        }[name]
    bench = draw_bench(rng, replace(recipe, short=short), like)
    noise = bench.reading * log_uniform(rng, 0.004, 0.04)
    return finish(rng, "none", name, seed, bench, {}, noise, name)


def hidden_direction_case(name: str, seed: int, short: bool = False) -> Case:
    """Return a case without effect whose motion is so slow that a noisy tachometer hides its direction for long
    periods.
    """
    rng = generator("hidden_direction", name, seed)
    fast = log_uniform(rng, 0.05, 0.25)
    recipe = Recipe(
        motion=name.removeprefix("slow_"),
        speed=fast,
        amplitude=fast * rng.uniform(0.8, 2.0),
        velocity="tachometer",
        velocity_noise=TACHOMETER_NOISE,
        sign_noise=np.inf,
        short=short,
    )
    bench = draw_bench(rng, recipe)
    noise = bench.reading * log_uniform(rng, 0.004, 0.04)
    return finish(rng, "hidden_direction", name, seed, bench, {}, noise, name)


def single_case(name: str, seed: int, short: bool = False, like: Bench | None = None) -> Case:
    """Return a case with one well excited effect that no other effect imitates within the noise.

    Its size is one to six times the noise. If `like` is given, the rig of that bench is used.
    """
    for attempt in range(200):
        rng = generator("single", name, seed, attempt)
        bench = draw_bench(rng, Recipe(**NEEDS.get(name, {}), short=short), like)
        ratio = log_uniform(rng, 1.12, 6.0)
        wanted = bench.reading * log_uniform(rng, 0.004, 0.03) * ratio
        parameters, reached = _strong(rng, name, bench, wanted)
        noise = min(reached / ratio, 0.1 * bench.reading)
        if reached > 8.0 * noise or noise < 2e-3 * bench.reading or not in_domain(bench, {name: parameters}):
            continue
        case = finish(rng, "single", name, seed, bench, {name: parameters}, noise, "rich")
        visible = case.truth.size >= np.hypot(case.truth.noise, case.truth.sign_noise)
        if visible and is_unique(bench, {name: parameters}, case.truth.noise):
            return case
    raise RuntimeError(f"no case of {name} for seed {seed}")


def timing_case(name: str, seed: int, short: bool = False) -> Case:
    """Return a case with one effect in one log of 60 s at 1 kHz."""
    rng = generator("timing", name, seed)
    bench = draw_bench(rng, Recipe(**NEEDS.get(name, {}), seconds=(60.0, 60.0), rate=1000, runs=1, short=short))
    parameters, reached = _strong(rng, name, bench, 0.04 * bench.scale)
    return finish(rng, "timing", name, seed, bench, {name: parameters}, reached / 3.0, "rich")


def pair_case(name: str, seed: int, short: bool = False) -> Case:
    """Return a case with two effects, each visible in the presence of the other and without an equivalent competing
    effect.

    `name` is "a+b", or "any" for a random pair.
    """
    for attempt in range(200):
        rng = generator("pair", name, seed, attempt)
        first, second = name.split("+") if name != "any" else _draw_pair(rng)
        needs = _needs_of_both(first, second)
        if "x" in needs and needs["x"][0] >= needs["x"][1]:  # no rig can show both effects
            continue
        bench = draw_bench(rng, Recipe(**needs, short=short))
        ratio = log_uniform(rng, 1.25, 4.0)
        wanted = bench.reading * log_uniform(rng, 0.004, 0.02) * ratio
        effects: dict[str, dict[str, Any]] = {}
        for effect in (first, second):
            effects[effect], _ = _strong(rng, effect, bench, wanted * rng.uniform(1.0, 2.0))
        if not in_domain(bench, effects):
            continue
        sizes = {effect: added_size(bench, effects, effect) for effect in effects}
        noise = min(sizes.values()) / ratio
        if noise < 2e-3 * bench.reading:
            continue
        case = finish(rng, "pair", name, seed, bench, effects, noise, "rich")
        case.truth.sizes = sizes
        visible = min(sizes.values()) >= np.hypot(case.truth.noise, case.truth.sign_noise)
        if visible and is_unique(bench, effects, case.truth.noise):
            return case
    raise RuntimeError(f"no case of {name} for seed {seed}")


def outside_case(name: str, seed: int, short: bool = False) -> Case:
    """Return a case with a cause outside the catalogue.

    The part that the whole catalogue cannot imitate is 2.2 to 6 times the noise.
    """
    stranger = STRANGERS[name]
    for attempt in range(200):
        rng = generator("outside", name, seed, attempt)
        bench = draw_bench(rng, Recipe(**stranger.needs, short=short))
        span = CatalogueSpan(bench)
        at = stranger.draw(rng, bench)
        ratio = log_uniform(rng, 2.2, 6.0)
        wanted = bench.reading * log_uniform(rng, 0.003, 0.015) * ratio

        def leftover(parameters: dict[str, Any], bench: Bench = bench, at: Any = at, span: Any = span) -> float:
            return float(span.leftover(bench.disturbed(at(parameters["strength"]))))

        strength = Strength(name, {}, "strength", stranger.start, stranger.cap)
        parameters, reached = solve(strength, wanted, leftover)
        noise = reached / ratio
        if not 2e-3 * bench.reading < noise < 0.06 * bench.reading:
            continue
        case = finish(rng, "outside", name, seed, bench, {}, noise, "rich", at(parameters["strength"]))
        case.truth.outside, case.truth.size = name, reached
        case.truth.sizes = {name: parameters["strength"]}
        if reached >= 2.0 * np.hypot(case.truth.noise, case.truth.sign_noise):
            return case
    raise RuntimeError(f"no case of {name} for seed {seed}")


def _draw_pair(rng: np.random.Generator) -> tuple[str, str]:
    while True:
        first, second = (str(effect) for effect in rng.choice(PAIRED, 2, replace=False))
        if not any({first, second} <= row for row in TWIN_ROWS):
            return first, second


def _needs_of_both(first: str, second: str) -> dict[str, Any]:
    """Return the stricter requirements of two effects."""
    needs = dict(NEEDS.get(first, {}))
    for key, value in NEEDS.get(second, {}).items():
        mine = needs.get(key)
        if mine is None or key == "temperature":
            needs[key] = "cycle" if "cycle" in (mine, value) else value
        elif key == "level":
            needs[key] = max(mine, value) if "tendon_slack" in (first, second) else min(mine, value)
        elif key == "x":
            needs[key] = (max(mine[0], value[0]), min(mine[1], value[1]))
        elif key == "amplitude":
            needs[key] = max(mine, value)
    return needs


def _strong(rng: np.random.Generator, name: str, bench: Bench, wanted: float) -> tuple[dict[str, Any], float]:
    """Return parameters of effect `name` with a size of about `wanted`, and the size reached (both N*m)."""
    return solve(draw_strength(rng, name, bench), wanted, lambda parameters: size(bench, {name: parameters}))


def in_domain(bench: Bench, effects: dict[str, dict[str, Any]]) -> bool:
    """Return True if both tendons are under tension in nearly all samples, or if slack is the hidden effect."""
    return "tendon_slack" in effects or bench.slack_share(effects) < 1e-3


def finish(
    rng: np.random.Generator,
    family: str,
    name: str,
    seed: int,
    bench: Bench,
    effects: dict[str, dict[str, Any]],
    noise: float,
    setting: str,
    disturb: Any = None,
) -> Case:
    effects = {
        effect: {key: float(value) if isinstance(value, np.floating) else value for key, value in parameters.items()}
        for effect, parameters in effects.items()
    }
    logs, torque_noise, sign_noise = record(rng, bench, effects, noise, disturb)
    rig = bench.rig
    truth = Truth(
        effects=effects,
        noise=torque_noise,
        sign_noise=sign_noise,
        size=size(bench, effects) if effects else 0.0,
        setting=setting + ": " + "; ".join(", ".join(run.motion.kinds) for run in bench.runs),
        numbers={
            "friction_angle": rig.x,
            "pretension": rig.pretension,
            "slope": rig.joint_radius / rig.motor_radius * float(np.cosh(rig.x)),
            "half_loop_torque": 2.0 * rig.pretension * rig.joint_radius * float(np.sinh(rig.x)),
        },
    )
    model = model_file(bench.nominal, state_uncertainty=bool(rng.random() < 0.3))
    return Case(family, name, seed, logs, model, truth, bench=bench)
