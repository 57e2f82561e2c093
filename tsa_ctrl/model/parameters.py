"""Read and write actuator model files; writing keeps the comments and states the provenance.

Symbols and units are those of the source, section 3.2: r_M, r_J, E A, l_us, d, k_s, mu, Theta, p, T_p0. Only the
product x = mu Theta (`friction_angle`) and T_p0 (`pretension`) are identifiable; see `TendonSheath.recalibrated`.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import tomlkit

from tsa_ctrl import settings
from tsa_ctrl.arguments import listing_arguments, path_of
from tsa_ctrl.errors import UsageError
from tsa_ctrl.model.actuator_file import (
    MOST_FRICTION,
    ActuatorFile,
    GearedDriveFile,
    RigidDriveFile,
    UncertaintySection,
)
from tsa_ctrl.model.catalogue import CATALOGUE, check_effects
from tsa_ctrl.model.curvature import Points, course_of
from tsa_ctrl.model.effects.specification import Kind
from tsa_ctrl.model.provenance import Origin, interval_low, origin_of, toml_table
from tsa_ctrl.model.routing import Routing

ROUTING_BY_JOINT = "routing_by_joint"  # the effect that a file contains as [routing]
Effects = Mapping[str, Mapping[str, Any]]  # the checked parameters of each effect, by its name


@dataclass(frozen=True)
class TendonSheath:
    """Describe a pair of tendon-sheaths between a motor and a joint pulley, in SI units.

    `pretension` is T_p0 in N at `bending_angle` without motor torque and friction. If the file has
    `unstrained_bending_angle` instead, T_p0 is computed from it by (3.51), (3.56).
    """

    motor_pulley_radius: float
    joint_pulley_radius: float
    axial_stiffness: float
    unstrained_length: float
    diameter: float
    friction_coefficient: float
    bending_angle: float
    pretension: float
    contact_offset: float = 0.0
    series_stiffness: float | None = None
    series_at_joint: bool = False
    bending_centre: float | None = None  # of the length from the motor; None: even bend, or by elongation_coupling
    bending_course: Points | None = None  # distribution of the bends; None: even. It changes only the elongation
    friction_angle_uncertainty: float = 0.25
    pretension_uncertainty: float = 0.25
    axial_stiffness_uncertainty: float = UncertaintySection().axial_stiffness
    bending_centre_uncertainty: float = UncertaintySection().bending_centre
    routing: Routing | None = None  # joints that bend the sheaths
    effects: Effects = field(default_factory=dict)
    source: str = ""
    half_loop_low: float | None = field(default=None, compare=False)  # N*m at the joint, of the calibration's interval
    origin: Origin = field(default_factory=Origin, compare=False)  # source of the numbers, and the joint's nodes

    kind: ClassVar[Kind] = Kind.TENDON_SHEATH
    target: ClassVar[str] = "tau_j"  # the column that the model predicts

    def __post_init__(self) -> None:
        """Set a missing reference_tension to the pretension, so that a recalibrated pretension does not change it."""
        dependence = self.effects.get("tension_dependent_friction")
        if dependence is None or "reference_tension" in dependence:
            return
        if not self.pretension > 0.0:
            raise UsageError(
                f"{self.source or 'model'}: [effects.tension_dependent_friction] has no reference_tension and the "
                "pretension is 0 N; give reference_tension (N)"
            )
        filled = {**dependence, "reference_tension": self.pretension}
        object.__setattr__(self, "effects", {**self.effects, "tension_dependent_friction": filled})

    @property
    def most_friction(self) -> float:
        """Return the largest x T_p by [uncertainty] over the file's value, 1: both factors at their upper limits."""
        return (1.0 + self.friction_angle_uncertainty) * (1.0 + self.pretension_uncertainty)

    @property
    def friction_angle(self) -> float:
        """Return x = mu Theta, 1."""
        return self.friction_coefficient * self.bending_angle

    @property
    def tendon_stiffness(self) -> float:
        """Return k_t = 1 / (l_us/EA + 1/k_s), N/m: pretension per change of the path length (3.56)."""
        spring = 0.0 if self.series_stiffness is None else 1.0 / self.series_stiffness
        return 1.0 / (self.unstrained_length / self.axial_stiffness + spring)

    @property
    def lever(self) -> float:
        """Return p + d/2, m: path length per bending angle (3.50).

        The value is for a spiral sheath, whose neutral axis is its inner arc.
        """
        return self.contact_offset + self.diameter / 2.0

    @property
    def pretension_slope(self) -> float:
        """Return dT_p0/dTheta = k_t (p + d/2), N/rad, by (3.51) and (3.56)."""
        return self.tendon_stiffness * self.lever

    @property
    def series_length(self) -> float:
        """Return EA / k_s, m: the contribution of a series spring to alpha and beta; 0 without one."""
        return 0.0 if self.series_stiffness is None else self.axial_stiffness / self.series_stiffness

    def recalibrated(self, friction_angle: float | None = None, pretension: float | None = None) -> TendonSheath:
        """Return the same actuator with another x and T_p0.

        Theta stays, and mu is changed with x. Beyond the largest possible mu, Theta is changed instead, because then
        Theta was wrong. Raises UsageError for another x if Theta is 0.
        """
        theta = self.bending_angle
        if friction_angle is None:
            mu = self.friction_coefficient
        elif theta > 0.0:
            mu = friction_angle / theta
            if mu > MOST_FRICTION:
                mu, theta = MOST_FRICTION, friction_angle / MOST_FRICTION
        else:
            raise UsageError(
                f"{self.source or 'model'}: bending_angle is 0, so the friction angle cannot change; give [sheath] "
                "bending_angle above 0"
            )
        level = self.pretension if pretension is None else pretension
        return dataclasses.replace(
            self, friction_coefficient=mu, bending_angle=theta, pretension=level, half_loop_low=None
        )

    def with_effects(self, effects: Mapping[str, Mapping[str, Any]]) -> TendonSheath:
        """Return the same actuator with these effects, after validation against the catalogue."""
        return dataclasses.replace(self, effects=check_effects(effects, self.source or "model"))


@dataclass(frozen=True)
class RigidDrive:
    """Describe a plain drive: tau_M = J domega/dt + tau_c sign(omega) + b omega + c; None: the file omits the value."""

    inertia: float | None = None
    coulomb_friction: float | None = None
    viscous_friction: float | None = None
    torque_offset: float | None = None
    effects: Effects = field(default_factory=dict)
    source: str = ""

    kind: ClassVar[Kind] = Kind.RIGID_DRIVE
    target: ClassVar[str] = "tau_m"


@dataclass(frozen=True)
class GearedDrive:
    """Describe a gear with a joint torque sensor, without tendons: tau_J = eta^s N tau_M - tau_c sigma - b omega_J.

    s is the sign of the power tau_M omega_J. None means that the file omits the value; the loss is then 0.
    """

    ratio: float  # N, motor turns per joint turn; exact, and never fitted
    efficiency: float | None = None  # eta, 1
    coulomb_friction: float | None = None  # N*m
    viscous_friction: float | None = None  # N*m*s/rad
    effects: Effects = field(default_factory=dict)
    source: str = ""

    kind: ClassVar[Kind] = Kind.GEARED_DRIVE
    target: ClassVar[str] = "tau_j"


Model = TendonSheath | RigidDrive | GearedDrive


@listing_arguments
def load_model(path: str | Path | Mapping[str, Any] | Model) -> Model:
    """Read an actuator model file.

    Args:
        path: path of the file, or its content as a mapping, as `tomllib` returns it. A model is returned unchanged.

    Raises:
        UsageError: the model has an error. The message is one line.
    """
    if isinstance(path, Model):
        return path
    if isinstance(path, Mapping):
        content = _builtin(path)
        settings.check_finite(content, "model")
        return model_from(content, "model")
    file = path_of(path, "model", "a model, the path of its file, or the content of that file as a mapping")
    return model_from(settings.read_toml(file), str(path))


def _builtin(value: Any) -> Any:
    """Return mappings, sequences and numbers of NumPy as the types that `tomllib` returns."""
    if isinstance(value, Mapping):
        return {str(key): _builtin(inner) for key, inner in value.items()}
    if isinstance(value, (np.ndarray, np.generic)):
        return _builtin(value.tolist())
    return [_builtin(inner) for inner in value] if isinstance(value, (list, tuple)) else value


def load_tendon_sheath(path: str | Path) -> TendonSheath:
    """Read a model file; raises UsageError if it does not describe a tendon-sheath actuator."""
    model = load_model(path)
    if not isinstance(model, TendonSheath):
        raise UsageError(
            f'{path}: [actuator] kind = "{model.kind.value}" cannot be used here; give a tendon-sheath model'
        )
    return model


def model_from(data: dict[str, Any], where: str) -> Model:
    """Return the model of parsed TOML; `where` states the source in errors."""
    section = data.get("actuator")
    kind = section.get("kind", Kind.TENDON_SHEATH.value) if isinstance(section, dict) else Kind.TENDON_SHEATH.value
    if kind not in (kinds := [each.value for each in Kind]):
        raise UsageError(f"{where}: [actuator] kind = {kind!r} is unknown; give one of {', '.join(kinds)}")
    if kind == Kind.RIGID_DRIVE.value:
        drive = settings.convert(data, RigidDriveFile, where)
        a = drive.actuator
        effects = _effects_of(drive.effects, Kind.RIGID_DRIVE, where)
        return RigidDrive(a.inertia, a.coulomb_friction, a.viscous_friction, a.torque_offset, effects, where)
    if kind == Kind.GEARED_DRIVE.value:
        geared = settings.convert(data, GearedDriveFile, where)
        g = geared.actuator
        effects = _effects_of(geared.effects, Kind.GEARED_DRIVE, where)
        return GearedDrive(g.ratio, g.efficiency, g.coulomb_friction, g.viscous_friction, effects, where)
    file = settings.convert(data, ActuatorFile, where)
    if file.tendon.series_position is not None and file.tendon.series_stiffness is None:
        raise UsageError(
            f"{where}: [tendon] series_position needs series_stiffness; give series_stiffness (N/m) or remove it"
        )
    centre, bends = file.sheath.bending_centre, file.sheath.bending_course
    course = None if bends is None else course_of(bends, where)
    model = TendonSheath(
        motor_pulley_radius=file.actuator.motor_pulley_radius,
        joint_pulley_radius=file.actuator.joint_pulley_radius,
        axial_stiffness=file.tendon.axial_stiffness,
        unstrained_length=file.tendon.unstrained_length,
        diameter=file.tendon.diameter,
        series_stiffness=file.tendon.series_stiffness,
        series_at_joint=file.tendon.series_position == "joint",
        friction_coefficient=file.sheath.friction_coefficient,
        bending_angle=file.sheath.bending_angle,
        contact_offset=file.sheath.contact_offset,
        bending_centre=course.centre if centre is None and course is not None else centre,
        bending_course=None if course is None else course.points,
        pretension=0.0,  # resolved below; it needs the stiffness
        friction_angle_uncertainty=file.uncertainty.friction_angle,
        pretension_uncertainty=file.uncertainty.pretension,
        axial_stiffness_uncertainty=file.uncertainty.axial_stiffness,
        bending_centre_uncertainty=file.uncertainty.bending_centre,
        routing=Routing.of(file.routing),
        source=where,
        half_loop_low=interval_low(file.provenance, "half_loop_torque"),
        origin=origin_of(file.provenance, where),
    )
    model = dataclasses.replace(model, pretension=_resolve_pretension(file, model, where))
    check_consistent(model, OFFLINE)
    return _with_routing_of_effects(dataclasses.replace(model, effects=check_effects(file.effects, where)))


def _effects_of(given: Mapping[str, Mapping[str, Any]], kind: Kind, where: str) -> Effects:
    effects = check_effects(given, where)
    for name in effects:
        if kind not in CATALOGUE[name].kinds:
            raise UsageError(f"{where}: [effects.{name}] has no meaning for a {kind.value}; remove it")
    return effects


def _with_routing_of_effects(model: TendonSheath) -> TendonSheath:
    """Return the model with [effects.routing_by_joint], the result of a diagnosis, added to its [routing]."""
    if ROUTING_BY_JOINT not in model.effects:
        return model
    effects = {name: values for name, values in model.effects.items() if name != ROUTING_BY_JOINT}
    return dataclasses.replace(
        model, effects=effects, routing=Routing.sum_of(model.routing, model.effects[ROUTING_BY_JOINT])
    )


def _resolve_pretension(file: ActuatorFile, model: TendonSheath, where: str) -> float:
    level, bent = file.pretension, ("[sheath] unstrained_bending_angle (rad)", file.sheath.unstrained_bending_angle)
    ways = ("[pretension] value (N)", level.value), ("[pretension] length_change (m)", level.length_change), bent
    given = [name for name, number in ways if number is not None]
    if len(given) > 1:
        raise UsageError(f"{where}: {' and '.join(given)} are given; keep one of them")
    if not given:
        raise UsageError(f"{where}: no pretension; give {' or '.join(name for name, _ in ways)}")
    if bent[1] is not None:
        return max(0.0, model.pretension_slope * (model.bending_angle - bent[1]))
    return model.tendon_stiffness * (level.length_change or 0.0) if level.value is None else level.value


def dump_model(model: Model, template: str | Path | None = None, provenance: Mapping[str, Any] | None = None) -> str:
    """Return the TOML text of a model, which can be loaded as the same model.

    Args:
        template: a model file whose comments and layout are kept.
        provenance: plain values or tables for `[provenance]`, the source of the numbers: log names and hashes, date,
            version and intervals.
    """
    if isinstance(model, TendonSheath):
        model = _with_routing_of_effects(model)
    document = tomlkit.document() if template is None else tomlkit.parse(Path(template).read_text(encoding="utf-8"))
    for section, values in _sections(model).items():
        table = document.setdefault(section, tomlkit.table())
        for key, value in values.items():
            if value is None:
                table.pop(key, None)
            elif table.get(key) != value:
                table[key] = value
    routing = model.routing if isinstance(model, TendonSheath) else None
    if routing is None:
        document.pop("routing", None)
    elif document.get("routing") != routing.section():
        document["routing"] = toml_table(routing.section())
    document.pop("effects", None)
    if model.effects:
        effects = tomlkit.table(is_super_table=True)
        for name, parameters in model.effects.items():
            table = tomlkit.table()
            for key, value in parameters.items():
                table[key] = [list(point) for point in value] if isinstance(value, tuple) else value
                if isinstance(value, int | float):
                    table[key].comment(CATALOGUE[name].parameter(key).unit)
            effects[name] = table
        document["effects"] = effects
    if provenance:
        document.pop("provenance", None)
        document["provenance"] = toml_table(provenance)
    text: str = tomlkit.dumps(document)
    return text if text.endswith("\n") else text + "\n"


def save_model(
    model: Model,
    path: str | Path,
    template: str | Path | None = None,
    provenance: Mapping[str, Any] | None = None,
) -> None:
    """Write the text of `dump_model` to a temporary file, and rename it to `path`."""
    settings.write_text(path, dump_model(model, template, provenance))


def _sections(model: Model) -> dict[str, dict[str, Any]]:
    if not isinstance(model, TendonSheath):
        names = [entry.name for entry in dataclasses.fields(model) if entry.name not in ("effects", "source")]
        return {"actuator": {"kind": model.kind.value, **{name: getattr(model, name) for name in names}}}
    known = ("friction_angle", "pretension")
    uncertainty: dict[str, float | None] = {name: getattr(model, f"{name}_uncertainty") for name in known}
    place, usual, course = "joint" if model.series_at_joint else "motor", UncertaintySection(), model.bending_course
    for name in ("axial_stiffness", "bending_centre"):  # written only if they were identified
        value = getattr(model, f"{name}_uncertainty")
        uncertainty[name] = None if value == getattr(usual, name) else value
    return {
        "actuator": {
            "motor_pulley_radius": model.motor_pulley_radius,
            "joint_pulley_radius": model.joint_pulley_radius,
        },
        "tendon": {
            "axial_stiffness": model.axial_stiffness,
            "unstrained_length": model.unstrained_length,
            "diameter": model.diameter,
            "series_stiffness": model.series_stiffness,
            "series_position": None if model.series_stiffness is None else place,
        },
        "sheath": {
            "friction_coefficient": model.friction_coefficient,
            "bending_angle": model.bending_angle,
            "contact_offset": model.contact_offset,
            "unstrained_bending_angle": None,
            "bending_centre": model.bending_centre,
            "bending_course": None if course is None else [list(point) for point in course],
        },
        "pretension": {"value": model.pretension, "length_change": None},
        "uncertainty": uncertainty,
    }


# Limits of the consistency of one file: two numbers may contradict each other although each is possible. A wrong unit
# is wrong by a factor of 10 to 1000. These are limits of materials, so they need no tuning.
#
#     E = EA / (pi d^2 / 4)       modulus of the tendon: soft polymer to carbon fibre
#     sigma = T_p0 / (pi d^2 / 4) stress at the pretension: the strongest wire
#     epsilon = T_p0 / EA         strain at the pretension: the most extensible strong fibre
#     R = l_us / Theta            mean radius of the bends: more than the tendon's own diameter
#     r_J / r_M                   ratio of two pulleys that share tendons

MODULUS = (0.3e9, 1000e9)  # Pa; a soft polymer has 0.5 GPa, the stiffest carbon fibre 900 GPa
STRENGTH = 3e9  # Pa, of the strongest steel wire; fibres are stronger, but fill only a part of a tendon's diameter
STRAIN = 0.04  # 1, breaking strain of the most extensible strong fibres (polyethylene, aramid)
SPRING_TRAVEL = 0.2  # 1, largest elongation of tendon and series spring by the pretension, over the tendon's length
MOST_FRICTION_ANGLE = 3.0  # 1; exp(3) = 20, so a twentieth of the tension reaches the joint
RATIO = 10.0  # 1, r_J/r_M or r_M/r_J; one tendon runs over both pulleys, so a larger ratio needs a gear
# Factor by which a file that no motor uses may exceed these limits. A log of a rig with a wrong unit can still be
# calibrated and diagnosed, and a table of random models needs no real material.
OFFLINE = 1e3


def check_consistent(model: TendonSheath, tolerance: float = 1.0) -> None:
    """Compare the numbers of one model file with each other.

    Args:
        model: the tendons and their sheaths.
        tolerance: factor by which a value may exceed its limit.

    Raises:
        UsageError: Two of them contradict each other. The message has both values, the range and the likely unit error.
    """
    where, tension = model.source or "model", model.pretension
    ratio = model.joint_pulley_radius / model.motor_pulley_radius
    if not 1.0 / RATIO / tolerance <= ratio <= RATIO * tolerance:
        raise UsageError(
            f"{where}: [actuator] joint_pulley_radius {model.joint_pulley_radius:g} m over motor_pulley_radius "
            f"{model.motor_pulley_radius:g} m is {ratio:.3g}; allowed is {1.0 / RATIO:g} to {RATIO:g}: give both radii "
            "in m, and a gear of the motor as [axis.drive] gear_ratio"
        )
    area = math.pi * model.diameter**2 / 4.0
    modulus, stress, strain = model.axial_stiffness / area, tension / area, tension / model.axial_stiffness
    given = f"[tendon] axial_stiffness {model.axial_stiffness:g} N and diameter {model.diameter:g} m"
    if not MODULUS[0] / tolerance <= modulus <= MODULUS[1] * tolerance:
        raise UsageError(
            f"{where}: {given} give a modulus of {1e-9 * modulus:.3g} GPa; allowed is {1e-9 * MODULUS[0]:g} to "
            f"{1e-9 * MODULUS[1]:g} GPa (soft polymer to carbon fibre): give E A in N, not in kN, and the diameter in m"
        )
    if strain > STRAIN * tolerance:
        raise UsageError(
            f"{where}: the pretension of {tension:g} N strains a tendon of axial_stiffness {model.axial_stiffness:g} N "
            f"by {100.0 * strain:.3g} %; allowed is {100.0 * STRAIN:g} %, where fibres break: give the pretension in N "
            "(gram-force times 0.00981) and E A in N"
        )
    if stress > STRENGTH * tolerance:
        raise UsageError(
            f"{where}: the pretension of {tension:g} N stresses a tendon of diameter {model.diameter:g} m by "
            f"{1e-9 * stress:.3g} GPa; allowed is {1e-9 * STRENGTH:g} GPa, the strongest wire: give the pretension in "
            "N (gram-force times 0.00981) and the diameter in m"
        )
    lengthened = tension / model.tendon_stiffness / model.unstrained_length
    if lengthened > SPRING_TRAVEL * tolerance:
        raise UsageError(
            f"{where}: the pretension of {tension:g} N lengthens tendon and series_stiffness "
            f"{model.series_stiffness or 0.0:g} N/m by {100.0 * lengthened:.3g} % of unstrained_length; allowed is "
            f"{100.0 * SPRING_TRAVEL:g} %: give series_stiffness in N/m, not in N/mm"
        )
    if model.friction_angle > MOST_FRICTION_ANGLE * tolerance:
        raise UsageError(
            f"{where}: [sheath] friction_coefficient {model.friction_coefficient:g} times bending_angle "
            f"{model.bending_angle:g} rad is {model.friction_angle:.3g}; allowed is {MOST_FRICTION_ANGLE:g}, where 5 % "
            "of the tension arrives: give the bending angle in rad, not in degrees"
        )
    if model.bending_angle * model.diameter > model.unstrained_length * tolerance:
        raise UsageError(
            f"{where}: [sheath] bending_angle {model.bending_angle:g} rad within unstrained_length "
            f"{model.unstrained_length:g} m bends to a radius below the tendon's diameter of {model.diameter:g} m: "
            "give lengths in m and the angle in rad"
        )
