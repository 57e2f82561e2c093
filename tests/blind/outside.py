"""Create causes outside the catalogue. Most of each cause remains when the whole catalogue is fitted."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.signal import lfilter

from . import memory
from .bench import Bench, Run, rms
from .motion import smoothed
from .plant import simulate
from .rivals import Thinned, imitations

Array = np.ndarray
Torque = Callable[[Bench, Run, Array], Array]


@dataclass(frozen=True)
class Stranger:
    """A cause outside the catalogue: its joint torque as a function of its strength, and the required excitation."""

    describe: str
    draw: Callable[[np.random.Generator, Bench], Callable[[float], Torque]]
    start: float
    cap: float
    needs: dict[str, Any]


def _clipping(rng: np.random.Generator, bench: Bench) -> Callable[[float], Torque]:
    peak = max(float(np.max(np.abs(y))) for y in bench.ideal({}))

    def at(strength: float) -> Torque:
        limit = (1.0 - strength) * peak
        return lambda bench, run, tau: np.clip(tau, -limit, limit)

    return at


def _temperature_crosstalk(rng: np.random.Generator, bench: Bench) -> Callable[[float], Torque]:
    def at(strength: float) -> Torque:
        return lambda bench, run, tau: tau + strength * bench.scale * (run.scene.temperature - 25.0) / 10.0

    return at


def _anchor_slip(rng: np.random.Generator, bench: Bench) -> Callable[[float], Torque]:
    when = rng.uniform(0.35, 0.65)

    def at(strength: float) -> Torque:
        def torque(bench: Bench, run: Run, tau: Array) -> Array:
            scale = np.where(run.scene.t > when * run.scene.t[-1], 1.0 - strength, 1.0)
            return simulate(bench.rig, replace(run.scene, pretension_scale=scale), {}).joint_torque

        return torque

    return at


def _ageing(rng: np.random.Generator, bench: Bench) -> Callable[[float], Torque]:
    """Return break-away friction that grows with the time at rest and decays over a distance."""
    ageing_time, wear = rng.uniform(0.05, 0.2), 0.25 * bench.reach

    def at(strength: float) -> Torque:
        def torque(bench: Bench, run: Run, tau: Array) -> Array:
            scene = run.scene
            step = scene.t[1] - scene.t[0]
            aged = np.log1p(memory.rest_time(scene.omega, step, 0.02 * bench.speed) / ageing_time)
            slid = memory.slid_since_rest(scene.q, scene.omega, 0.02 * bench.speed)
            scale = 1.0 + strength * aged * np.exp(-slid / wear)
            return simulate(bench.rig, replace(scene, friction_scale=scale), {}).joint_torque

        return torque

    return at


def _viscoelastic(rng: np.random.Generator, bench: Bench) -> Callable[[float], Torque]:
    """Return a Maxwell element in the tendon: part of the torque relaxes within about a second."""
    time_constant = rng.uniform(0.25, 1.5)

    def at(strength: float) -> Torque:
        def torque(bench: Bench, run: Run, tau: Array) -> Array:
            step = run.scene.t[1] - run.scene.t[0]
            return tau - strength * (tau - memory.first_order_lag(tau, step, time_constant))

        return torque

    return at


def _resonance(rng: np.random.Generator, bench: Bench) -> Callable[[float], Torque]:
    """Return a torque sensor on a soft mount that rings after every step."""
    frequency, damping = rng.uniform(5.0, 15.0), rng.uniform(0.02, 0.08)

    def at(strength: float) -> Torque:
        def torque(bench: Bench, run: Run, tau: Array) -> Array:
            step = run.scene.t[1] - run.scene.t[0]
            pole = np.exp(2.0 * np.pi * frequency * step * (-damping + 1j * np.sqrt(1.0 - damping**2)))
            a = np.array([1.0, -2.0 * pole.real, abs(pole) ** 2])
            change = tau - tau[0]
            return tau[0] + change + strength * (lfilter([a.sum()], a, change) - change)

        return torque

    return at


def _kink(rng: np.random.Generator, bench: Bench) -> Callable[[float], Torque]:
    """Return a kink of the sheath, which raises the friction near one joint angle."""
    q = np.concatenate([run.scene.q for run in bench.runs])
    place, width = np.quantile(q, rng.uniform(0.3, 0.7)), rng.uniform(0.04, 0.1) * np.ptp(q)

    def at(strength: float) -> Torque:
        def torque(bench: Bench, run: Run, tau: Array) -> Array:
            scale = 1.0 + strength * np.exp(-0.5 * ((run.scene.q - place) / width) ** 2)
            return simulate(bench.rig, replace(run.scene, friction_scale=scale), {}).joint_torque

        return torque

    return at


def _sensor_hysteresis(rng: np.random.Generator, bench: Bench) -> Callable[[float], Torque]:
    """Return a torque sensor whose reading depends on the previous direction of the torque."""
    width = rng.uniform(0.2, 0.6) * bench.scale

    def at(strength: float) -> Torque:
        return lambda bench, run, tau: tau + strength * bench.scale * memory.bristle(tau, width, 0.0)

    return at


def _dead_zone(rng: np.random.Generator, bench: Bench) -> Callable[[float], Torque]:
    def at(strength: float) -> Torque:
        zone = strength * bench.scale
        return lambda bench, run, tau: np.sign(tau) * np.maximum(np.abs(tau) - zone, 0.0)

    return at


def _beating(rng: np.random.Generator, bench: Bench) -> Callable[[float], Torque]:
    """Return a pretension that oscillates slowly without an external cause."""
    frequency, phase = rng.uniform(0.2, 1.2), rng.uniform(0.0, 2.0 * np.pi)

    def at(strength: float) -> Torque:
        def torque(bench: Bench, run: Run, tau: Array) -> Array:
            scale = 1.0 + strength * np.sin(2.0 * np.pi * frequency * run.scene.t + phase)
            return simulate(bench.rig, replace(run.scene, pretension_scale=scale), {}).joint_torque

        return torque

    return at


def _frozen(rng: np.random.Generator, bench: Bench) -> Callable[[float], Torque]:
    """Return an occasional loss of torque messages. The last value is held for a tenth of a second or more."""
    seed = int(rng.integers(2**31))

    def at(strength: float) -> Torque:
        def torque(bench: Bench, run: Run, tau: Array) -> Array:
            draw = np.random.default_rng(seed)
            rate = 1.0 / (run.scene.t[1] - run.scene.t[0])
            keep = np.arange(tau.size)
            for start in np.flatnonzero(draw.random(tau.size) < 0.6 * min(strength, 1.0) / rate):
                stop = start + int(draw.uniform(0.1, 0.4) * max(strength, 1.0) * rate)
                keep[start:stop] = keep[start]
            return tau[keep]

        return torque

    return at


def _oval(rng: np.random.Generator, bench: Bench) -> Callable[[float], Torque]:
    """Return an oval joint pulley, whose lever arm changes twice per revolution."""
    phase = rng.uniform(0.0, 2.0 * np.pi)

    def at(strength: float) -> Torque:
        return lambda bench, run, tau: tau * (1.0 + strength * np.sin(2.0 * run.scene.q + phase))

    return at


def _zero_drift(rng: np.random.Generator, bench: Bench) -> Callable[[float], Torque]:
    """Return a torque sensor whose zero drifts."""
    seed = int(rng.integers(2**31))

    def at(strength: float) -> Torque:
        def torque(bench: Bench, run: Run, tau: Array) -> Array:
            draw = np.random.default_rng(seed)
            step = run.scene.t[1] - run.scene.t[0]
            walk = smoothed(np.cumsum(draw.standard_normal(tau.size)), 0.5 / step)
            walk -= walk.mean()
            return tau + strength * bench.scale * walk / np.std(walk)

        return torque

    return at


def _bridge(rng: np.random.Generator, bench: Bench) -> Callable[[float], Torque]:
    """Return a torque sensor whose gains for positive and negative torque differ."""

    def at(strength: float) -> Torque:
        return lambda bench, run, tau: np.where(tau > 0.0, (1.0 + strength) * tau, (1.0 - strength) * tau)

    return at


STRANGERS: dict[str, Stranger] = {
    "sensor_clipping": Stranger("the torque sensor saturates", _clipping, 0.3, 0.75, {}),
    "temperature_crosstalk": Stranger(
        "the torque sensor feels the temperature", _temperature_crosstalk, 0.05, 0.5, {"temperature": "cycle"}
    ),
    "anchor_slip": Stranger(
        "an anchor slips: the pretension drops at once", _anchor_slip, 0.15, 0.5, {"level": (0.2, 0.45)}
    ),
    "ageing_friction": Stranger("friction grows while at rest", _ageing, 0.3, 3.0, {"velocity": "encoder"}),
    "viscoelastic_tendon": Stranger("the tendon creeps", _viscoelastic, 0.1, 0.5, {}),
    "sensor_resonance": Stranger("the torque sensor rings", _resonance, 1.0, 1.0, {}),
    "sheath_kink": Stranger("a kink in the sheath", _kink, 0.4, 3.0, {"joint_angle": True}),
    "sensor_hysteresis": Stranger("the torque sensor has a hysteresis", _sensor_hysteresis, 0.05, 0.3, {}),
    "sensor_dead_zone": Stranger("the torque sensor has a dead zone", _dead_zone, 0.1, 0.6, {}),
    "tension_beating": Stranger("the pretension beats", _beating, 0.1, 0.4, {"level": (0.2, 0.5)}),
    "frozen_samples": Stranger("torque telegrams get lost", _frozen, 1.0, 3.0, {}),
    "oval_pulley": Stranger("the joint pulley is not round", _oval, 0.05, 0.3, {"joint_angle": True}),
    "zero_drift": Stranger("the torque sensor's zero walks", _zero_drift, 0.05, 0.4, {}),
    "bridge_asymmetry": Stranger("the torque sensor has two gains", _bridge, 0.05, 0.3, {}),
}

# Functions of logged signals at one instant; the other causes have memory or depend on time
OF_AN_INSTANT = (
    "sensor_clipping",
    "temperature_crosstalk",
    "sheath_kink",
    "sensor_dead_zone",
    "oval_pulley",
    "bridge_asymmetry",
)


# Causes with the memory of a filter of the load, which a formula can represent as well
OF_A_FILTER = ("viscoelastic_tendon", "sensor_resonance", "sensor_hysteresis")
# Causes that depend on time: from a certain time on, or periodic
OF_A_CLOCK = ("anchor_slip", "tension_beating")


class CatalogueSpan:
    """The linear space of torque changes that the catalogue can imitate, linearised about the rig without effects."""

    def __init__(self, bench: Bench) -> None:
        self.thin = Thinned(bench)
        columns = [np.ones_like(self.thin.plain), self.thin.plain, *self.thin.recalibration()]
        for imitation in imitations(self.thin):
            columns += [column for column in imitation.columns if rms(column) > 1e-9 * bench.scale]
        matrix = np.stack([column / rms(column) for column in columns], axis=1)
        left, values, _ = np.linalg.svd(matrix, full_matrices=False)
        self.basis = left[:, values > 1e-5 * values[0]]

    def leftover(self, torques: list[Array]) -> float:
        """Return the RMS (N·m) of the part of a change of joint torque that no mixture of the catalogue imitates."""
        change = self.thin.join(torques) - self.thin.plain
        return rms(change - self.basis @ (self.basis.T @ change))
