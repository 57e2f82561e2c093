"""The size of an effect: what of it is left after the friction angle and the pretension are fitted anew."""

from __future__ import annotations

import numpy as np
from scipy.optimize import minimize_scalar

from . import memory
from .bench import Bench, rms
from .plant import Effects

Array = np.ndarray

UNCERTAINTY = 0.25  # factor either way, minus 1: how far recalibration may go from nominal


class Recalibration:
    """Least squares over x and T_p of the plain model, within the uncertainty, on noise-free channels of all runs."""

    def __init__(self, bench: Bench, effects: Effects, stride: int = 1) -> None:
        self.rig, self.nominal = bench.rig, bench.nominal
        self.stride = stride
        tau, theta, sigma = [], [], []
        for run in bench.runs:
            tau.append(run.pick(run.scene.tau_m)[::stride])
            theta.append(run.pick(run.scene.theta)[::stride])
            sigma.append(run.pick(memory.direction(bench.seen_velocity(run, effects)))[::stride])
        self.tau, self.theta, self.sigma = (np.concatenate(part) for part in (tau, theta, sigma))
        self.shift = self.rig.tension_per_bending * (self.theta - self.rig.bending)
        self.bent = bool(np.ptp(self.theta) > 0.0)

    def model(self, x: float, pretension: float) -> Array:
        """Joint torque of the plain model with friction angle x at the nominal bending."""
        angle = x * self.theta / self.rig.bending
        half = self.tau / (2.0 * self.rig.motor_radius)
        tension = pretension + self.shift
        t2 = (tension - half) * np.exp(self.sigma * angle)
        t4 = (tension + half) * np.exp(-self.sigma * angle)
        return self.rig.joint_radius * (t4 - t2)

    def fit(self, torque: Array) -> tuple[float, float, Array]:
        """x, T_p and residual of the best recalibrated plain model of `torque`."""
        nominal_x, nominal_t = self.nominal.x, self.nominal.pretension
        low, high = 1.0 / (1.0 + UNCERTAINTY), 1.0 + UNCERTAINTY

        def pretension(x: float) -> tuple[float, Array]:
            at_zero = self.model(x, 0.0)
            slope = self.model(x, 1.0) - at_zero
            best = float(slope @ (torque - at_zero) / max(float(slope @ slope), 1e-300))
            best = float(np.clip(best, low * nominal_t, high * nominal_t))
            return best, torque - at_zero - best * slope

        found = minimize_scalar(
            lambda x: float(np.sum(pretension(x)[1] ** 2)),
            bounds=(low * nominal_x, high * nominal_x),
            method="bounded",
            options={"xatol": 1e-5 * nominal_x},
        )
        ends = [low * nominal_x, high * nominal_x, float(found.x)]
        x = min(ends, key=lambda value: float(np.sum(pretension(value)[1] ** 2)))
        best, residual = pretension(x)
        return x, best, residual


def size(bench: Bench, effects: Effects, stride: int = 1) -> float:
    """RMS in N·m of what recalibration leaves of all these effects together."""
    fit = Recalibration(bench, effects, stride)
    torque = np.concatenate([y[::stride] for y in bench.ideal(effects)])
    return rms(fit.fit(torque)[2])


def added_size(bench: Bench, effects: Effects, name: str) -> float:
    """RMS in N·m of what effect `name` adds to the others, recalibration and the others' strengths fitted anew.

    The freedom of the other effects is taken as linear in their parameters about the truth.
    """
    fit = Recalibration(bench, effects)
    others = {key: dict(value) for key, value in effects.items() if key != name}
    whole = np.concatenate(bench.ideal(effects))
    without = np.concatenate(bench.ideal(others))
    x, pretension = bench.rig.x, bench.rig.pretension
    tangents = [
        fit.model(1.01 * x, pretension) - fit.model(0.99 * x, pretension),
        fit.model(x, 1.01 * pretension) - fit.model(x, 0.99 * pretension),
    ]
    for key, parameters in others.items():
        for parameter, value in parameters.items():
            if isinstance(value, str) or parameter in ("cycles_per_revolution", "elements", "start_time"):
                continue
            step = 0.02 * abs(value) if value else 0.02
            moved = {**others, key: {**parameters, parameter: value + step}}
            tangents.append(np.concatenate(bench.ideal(moved)) - without)
    basis = np.stack([column / max(rms(column), 1e-300) for column in tangents], axis=1)
    difference = whole - without
    solution = np.linalg.lstsq(basis, difference, rcond=1e-9)[0]
    return rms(difference - basis @ solution)
