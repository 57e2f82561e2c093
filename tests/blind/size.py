"""Calculate the size of an effect: its residual after friction angle and pretension are fitted again."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize_scalar

from . import memory
from .bench import Bench, rms
from .plant import Effects
from .rig import Rig

Array = np.ndarray

UNCERTAINTY = 0.25  # largest relative change of a nominal value by recalibration, up and down
ENOUGH = 5000  # number of samples that determine two values well enough


@dataclass(frozen=True)
class Channels:
    """Noise-free input of the plain model for all runs: motor torque, wrap angle and recorded direction."""

    rig: Rig  # its x and pretension are not used
    tau_m: Array
    theta: Array
    sigma: Array

    def thinned(self, stride: int) -> Channels:
        return Channels(self.rig, self.tau_m[::stride], self.theta[::stride], self.sigma[::stride])

    def plain(self, x: float, pretension: float) -> Array:
        """Return the joint torque (N*m) of the plain model.

        Friction angle x and pretension (N) are the values at the rig's nominal wrap angle.
        """
        angle = x * self.theta / self.rig.bending
        half = self.tau_m / (2.0 * self.rig.motor_radius)
        tension = pretension + self.rig.tension_per_bending * (self.theta - self.rig.bending)
        t2 = (tension - half) * np.exp(self.sigma * angle)
        t4 = (tension + half) * np.exp(-self.sigma * angle)
        return self.rig.joint_radius * (t4 - t2)

    def best_pretension(self, x: float, torque: Array, low: float, high: float) -> tuple[float, Array]:
        """Return the pretension within bounds that fits `torque` best at this x, and the residual."""
        at_zero = self.plain(x, 0.0)
        slope = self.plain(x, 1.0) - at_zero
        best = float(slope @ (torque - at_zero)) / max(float(slope @ slope), 1e-300)
        best = min(max(best, low), high)
        return best, torque - at_zero - best * slope


def channels(bench: Bench, effects: Effects) -> Channels:
    """Return noise-free channels.

    If the effects contain a velocity lag, the direction is the sign of the lagged velocity.
    """
    sigma: list[Array] = []
    for run in bench.runs:
        late = "velocity_lag" in effects
        sigma.append(run.pick(memory.direction(bench.seen_velocity(run, effects))) if late else run.sparse.direction())
    tau_m = np.concatenate([run.sparse.tau_m for run in bench.runs])
    theta = np.concatenate([run.sparse.theta for run in bench.runs])
    return Channels(bench.rig, tau_m, theta, np.concatenate(sigma))


def recalibrated(nominal: Rig, seen: Channels, torque: Array) -> tuple[float, float, Array]:
    """Return x, T_p and residual of the best plain model within the uncertainty of the nominal values."""
    low, high = 1.0 / (1.0 + UNCERTAINTY), 1.0 + UNCERTAINTY
    bounds = low * nominal.pretension, high * nominal.pretension
    stride = max(1, torque.size // ENOUGH)
    few, few_torque = seen.thinned(stride), torque[::stride]

    def misfit(x: float) -> float:
        return rms(few.best_pretension(x, few_torque, *bounds)[1])

    ends = low * nominal.x, high * nominal.x
    found = minimize_scalar(misfit, bounds=ends, method="bounded", options={"xatol": 1e-5 * nominal.x})
    x = min((*ends, float(found.x)), key=misfit)
    pretension, residual = seen.best_pretension(x, torque, *bounds)
    return x, pretension, residual


def size(bench: Bench, effects: Effects) -> float:
    """Return the RMS (N·m) of the residual of all these effects together after recalibration."""
    torque = np.concatenate(bench.ideal(effects))
    return rms(recalibrated(bench.nominal, channels(bench, effects), torque)[2])


def added_size(bench: Bench, effects: Effects, name: str) -> float:
    """Return the RMS (N·m) that effect `name` adds to the others.

    Recalibration and all parameters of the other effects are fitted again in a model linearised about the truth.
    """
    others = {key: dict(value) for key, value in effects.items() if key != name}
    whole = np.concatenate(bench.ideal(effects))
    without = np.concatenate(bench.ideal_as_seen(others, effects) if name == "velocity_lag" else bench.ideal(others))
    seen, x, pretension = channels(bench, effects), bench.rig.x, bench.rig.pretension
    tangents = [
        seen.plain(1.01 * x, pretension) - seen.plain(0.99 * x, pretension),
        seen.plain(x, 1.01 * pretension) - seen.plain(x, 0.99 * pretension),
    ]
    alone = np.concatenate(bench.ideal(others))
    for key, parameters in others.items():
        for parameter, value in parameters.items():
            if isinstance(value, str) or parameter in ("cycles_per_revolution", "elements", "reference_tension"):
                continue
            moved = {**others, key: {**parameters, parameter: value + (0.02 * abs(value) or 0.02)}}
            tangents.append(np.concatenate(bench.ideal(moved)) - alone)
    basis = np.stack([column / rms(column) for column in tangents if rms(column) > 1e-12 * bench.scale], axis=1)
    difference = whole - without
    solution = np.linalg.lstsq(basis, difference, rcond=1e-9)[0]
    return rms(difference - basis @ solution)
