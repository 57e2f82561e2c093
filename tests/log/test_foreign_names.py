"""Names of other programs determine the column by their words, and never by accident."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import pytest

from tsa_ctrl.log.foreign import mapping
from tsa_ctrl.log.foreign.names import Name
from tsa_ctrl.log.foreign.text import NO_TEXT, ForeignTable
from tsa_ctrl.log.foreign.units import quantities_of, scale_of

CASES = [
    # canonical names, with units and in paths
    ("t", "t", "s"), ("tau_j_des", "tau_j_des", "N*m"), ("theta", "theta", "rad"), ("tau_m [mNm]", "tau_m", "mNm"),
    ("sens.tau_j", "tau_j", "N*m"), ("out.tau_m.data", "tau_m", "N*m"), ("motor/theta", "q_m", None),
    # English, German, French, Italian, Spanish, Portuguese
    ("joint_torque_measured [Nm]", "tau_j", "Nm"), ("knee_angle_deg", "q_j", "deg"),
    ("knee motor torque", "tau_m", None),
    ("input_shaft_torque", "tau_m", None), ("motor_current_A", "tau_m", "A"), ("current motor position", "q_m", None),
    ("Torque (motor) [Nm]", "tau_m", "Nm"), ("motor_torque_mNm_filtered", "tau_m", "mNm"),
    ("actuator temperature [°C]", "temperature", "°C"), ("bending angle [deg]", "theta", "deg"),
    ("Antriebsdrehmoment [Nm]", "tau_m", "Nm"), ("Sollmoment [Nm]", "tau_j_des", "Nm"), ("Hüftmoment", "", None),
    ("Drehzahl Motor [U/min]", "omega_m", "U/min"), ("Drehmoment des Motors [Nm]", "tau_m", "Nm"),
    ("Kniewinkel", "q_j", None), ("Biegewinkel [°]", "theta", "°"),
    ("Vitesse moteur [tr/min]", "omega_m", "tr/min"), ("Erreur couple moteur", "", None),
    ("Angolo giunto [gradi]", "q_j", "gradi"), ("Ángulo articulación (°)", "q_j", "°"),
    ("Posição da junta [rad]", "q_j", "rad"), ("Consigne couple articulation [Nm]", "tau_j_des", "Nm"),
    # camelCase, compounds and symbols
    ("MotorTorque", "tau_m", None), ("tauM", "tau_m", None), ("jointtorque", "tau_j", None),
    ("motorSpeedRPM", "omega_m", None), ("joint1_torque", "tau_j", None), ("motor_rpm", "omega_m", "rpm"),
    ("i_q_m [A]", "tau_m", "A"), ("dq_j", "omega_j", None), ("w_m", "omega_m", None), ("q_knee", "q_j", None),
    ("theta_joint (rad)", "q_j", "rad"), ("M_Motor [Nm]", "tau_m", "Nm"), ("M_J", "tau_j", None),
    ("F_N_motor", "", None),
    ("T_mot [Nm]", "tau_m", "Nm"), ("T_mot [°C]", "temperature", "°C"), ("n_Motor [1/min]", "omega_m", "1/min"),
    ("M_soll_Gelenk [Nm]", "tau_j_des", "Nm"), ("M_soll_Motor", "", None), ("qd_joint", "omega_j", None),
    # a factor in the name is not known to be in the values
    ("Motor torque*1000 [Nm]", "", "Nm"), ("motor torque x10 [Nm]", "", "Nm"),
    # the unit is the only word of a quantity, or has several words
    ("Motor [mNm]", "tau_m", "mNm"), ("Motor friction [Nm]", "", "Nm"), ("Motor [V]", "", "V"),
    ("motor_torque_N_m", "tau_m", "N_m"), ("motor torque lbf in", "tau_m", "lbf in"), ("torque_nm", "", "nm"),
    ("joint_vel_deg_per_s", "omega_j", "deg_per_s"), ("joint_angle_rad_min", "", None),
    ("motor angle velocity [rpm]", "omega_m", "rpm"), ("joint1/motor/torque", "tau_m tau_j", None),
    # derivatives, and names of ROS and of robots
    ("theta_dot_m", "omega_m", None), ("qdot_j", "omega_j", None), ("phi_punkt_Motor", "omega_m", None),
    ("q_m_dot", "omega_m", None), ("theta_j_dot", "omega_j", None), ("q_j_ddot", "", None),
    ("theta_ddot_m", "", None), ("motor acceleration", "", None), ("ddq_m", "", None), ("joint.effort", "tau_j", None),
    ("tau_ext", "tau_j", None), ("link position [rad]", "q_j", "rad"), ("rotor_speed", "omega_m", None),
    # letters
    ("M_soll", "tau_j_des", None), ("th_m", "q_m", None), ("T_m [Nm]", "tau_m", "Nm"),
    ("T_j", "tau_j temperature", None),
    ("tau_in", "tau_m", None), ("q_out", "q_j", None), ("M_ist", "", None), ("motor_in", "", None),
    # time
    ("t_ms", "t", "ms"), ("s", "t", None), ("time (h:m:s)", "t", "h:m:s"), ("Clock [s]", "t", "s"),
    ("T [degC]", "", "degC"),
    # paths
    ("Model Root/tau_m/Out1 [Nm]", "tau_m", "Nm"), ("run1/sens/joint_angle", "q_j", None),
    ("motor/torque", "tau_m", None),
    ("out.q_j.time", "t", None), ("motor_torque.effort.knee", "tau_m", None),
    ("desired/joint_torque", "tau_j_des", None),
    # desired
    ("torque_ref [Nm]", "tau_j_des", "Nm"), ("Torque set-point", "tau_j_des", None),
    # not a column: commands, errors, limits, other words
    ("commanded motor torque", "", None), ("motor torque reference", "", None), ("joint torque error [Nm]", "", "Nm"),
    ("motor_torque_min", "", None), ("desired torque limit", "", None), ("command/motor_torque", "", None),
    ("lifetime", "", None), ("cycle time [ms]", "", "ms"), ("joint power w", "", None), ("i_q [A]", "", "A"),
    ("F_cell_N", "", "N"), ("motor torque constant", "", None),
]  # fmt: skip


@pytest.mark.parametrize(("source", "column", "unit"), CASES)
def test_a_name_is_identified_by_its_words(source: str, column: str, unit: str | None) -> None:
    name = Name(source)
    assert name.columns == set(column.split())
    assert name.unit == unit


def table(names: Sequence[str], **cells: list[str]) -> ForeignTable:
    return ForeignTable(
        Path("x.csv"), NO_TEXT, tuple(names), {name: cells.get(name, ["0.5", "0.9", "1.4"]) for name in names}, 1, 0
    )


@pytest.mark.parametrize(
    ("names", "source", "question"),
    [
        (["motor torque [Nm]", "tau_m"], "tau_m", False),
        (["motor current [A]", "motor torque [mNm]"], "motor torque [mNm]", False),
        (["motor torque reference [Nm]", "motor torque actual [Nm]"], "motor torque actual [Nm]", False),
        (["motor torque raw [Nm]", "motor torque [Nm]"], "motor torque [Nm]", False),
        (["motor1 torque [Nm]", "motor2 torque [Nm]"], "motor1 torque [Nm]", True),
        (["motor torque [Nm]", "motor torque filtered [Nm]"], "motor torque [Nm]", True),
        (["joint motor torque [Nm]"], "joint motor torque [Nm]", True),
    ],
)
def test_of_several_names_the_best_is_used_or_a_question_is_open(names: list[str], source: str, question: bool) -> None:
    found = mapping.identify(table(names), {})
    assert found.columns["tau_m"].source == source
    assert bool(found.questions) == question
    if question:
        assert found.questions[0][1] == f"tau_m={source}|Nm"


@pytest.mark.parametrize(
    ("names", "missing", "proposal"),
    [
        (["torque_mNm"], "tau_m", "tau_m=torque_mNm|mNm"),
        (["torque"], "tau_m", "tau_m=torque|N*m"),
        (["i_q", "iq", "Strom", "I", "i_sd", "voltage", "U", "force"], "tau_m", ""),
        (["torque error", "motor torque command", "torque limit", "angle", "speed", "x [deg]", "i [A]"], "tau_m", ""),
        (["knee torque", "x"], "tau_m", "tau_m=x|N*m"),
        (["q", "dq", "x", "tau"], "tau_m", "tau_m=tau|N*m"),
        (["q", "dq", "theta_dot", "Position"], "tau_m", ""),
        (["angle", "x"], "t", "t=x|s"),
        (["x_ms"], "t", "t=x_ms|ms"),
    ],
)
def test_a_proposal_uses_the_unit_and_no_other_quantity(names: list[str], missing: str, proposal: str) -> None:
    assert mapping.propose(table(names), missing, set()) == proposal


PLACES = [
    (["motor torque [Nm]", "q", "dq"], {"q_m=q|rad", "omega_m=dq|rad/s"}),
    (["motor torque [Nm]", "joint torque [Nm]", "Winkel [deg]", "n"], {"q_j=Winkel [deg]|deg", "omega_j=n|rad/s"}),
    (["motor torque [Nm]", "torque", "angle"], {"tau_j=torque|N*m", "q_j=angle|rad"}),
    (["motor torque [Nm]", "q_m", "position"], {"q_j=position|rad"}),
    (["motor torque [Nm]", "phi_ist [°]", "n_ist [1/min]"], {"q_m=phi_ist [°]|°", "omega_m=n_ist [1/min]|1/min"}),
    (["motor torque [Nm]", "q1", "q2", "hand position", "q_des", "speed limit"], set()),
]  # fmt: skip


@pytest.mark.parametrize(("names", "proposals"), PLACES)
def test_a_quantity_without_motor_or_joint_is_proposed_where_it_is_missing(
    names: list[str], proposals: set[str]
) -> None:
    foreign = table(names)
    found = mapping.identify(foreign, {})
    mapped = mapping.resolve(foreign, found.columns, "")
    assert {proposal for _, proposal in mapping.optional(foreign, mapped)} == proposals


@pytest.mark.parametrize(
    ("names", "remedy"),
    [
        (["Angle (deg)", "Current (A)"], "give --column 'tau_m=Current (A)|A*K', where K is the torque in N*m per A"),
        (
            ["torque [0.1%]", "i [A]"],
            "give --column 'tau_m=torque [0.1%]|0.1%*K', where K is the torque in N*m per 0.1%",
        ),
        (["q_m", "tau_cmd"], "to use the commanded torque, give --column 'tau_m=tau_cmd|N*m'"),
        (["joint torque command", "x [V]"], "give --column tau_m=NAME|UNIT"),
    ],
)
def test_the_remedy_names_a_current_or_a_commanded_torque(names: list[str], remedy: str) -> None:
    assert mapping.remedy_of(table(names), "tau_m", set()) == remedy


def test_a_row_number_is_not_proposed_as_speed() -> None:
    foreign = table(["motor torque [Nm]", "n"], n=["7", "8", "9"])
    assert mapping.optional(foreign, mapping.resolve(foreign, mapping.identify(foreign, {}).columns, "")) == []


def test_forces_are_named_in_a_log_without_joint_torque() -> None:
    foreign = table(["Load cell (N)", "motor torque [Nm]", "joint torque [Nm]"])
    mapped = mapping.resolve(foreign, mapping.identify(foreign, {}).columns, "")
    assert mapping.forces(foreign, []) == ["Load cell (N)"]
    assert mapping.forces(foreign, mapped) == []


def test_a_row_number_is_not_proposed_as_time() -> None:
    assert mapping.propose(table(["sample"], sample=["0", "1", "2"]), "t", set()) == ""


def test_a_time_stamp_is_not_proposed_as_torque() -> None:
    stamps = [f"{1_700_000_000_000_000_000 + i}" for i in (0, 2_000_000, 4_500_000)]
    assert mapping.propose(table(["stamp", "effort0"], stamp=stamps), "tau_m", set()) == "tau_m=effort0|N*m"


def test_a_name_of_two_quantities_is_a_question_without_a_proposal() -> None:
    found = mapping.identify(table(["T_mot"]), {})
    assert found.columns == {}
    ((question, proposal),) = found.questions
    assert "--column 'tau_m=T_mot|N*m' or --column 'temperature=T_mot|degC'" in question
    assert proposal == ""


UNITS = [
    ("N*m", 1.0, ["N*m", "Nm", "N m", "N.m", "N-m", "N·m", "N⋅m", "N × m", "nm", "NM", "N_m", "n_m", "newton meters"]),
    ("N*m", 4.4482216152605 * 0.0254, ["lbf·in", "lbf*in", "lbf-in", "in-lbf", "lbf in", "lbin", "in·lb", "lbf_in"]),
    ("N*m", 4.4482216152605 * 0.3048, ["lbf·ft", "ft-lbs", "ft.lb", "lbft", "pound-feet"]),
    ("N*m", 0.0980665, ["kgf*cm", "kgf·cm", "kg-cm", "kgcm", "kp cm"]),
    ("N*m", 9.80665, ["kgf·m", "kg.m", "kgfm"]),
    ("N*m", 4.4482216152605 / 16.0 * 0.0254, ["ozf·in", "oz-in", "ozin", "in oz"]),
    ("N*m", 1e-3, ["mNm", "mN·m", "N·mm", "Nmm", "mN m", "mnm"]),
    ("N*m", 1e-6, ["mN·mm", "uN*m"]),
    ("N*m", 1e-2, ["N·cm", "Ncm"]),
    ("rad/s", 2.0 * math.pi, ["rev/s", "rps", "U/s", "turns/sec", "rev·s⁻¹", "rev s^-1", "rev_s"]),
    ("rad/s", math.pi / 30.0, ["rpm", "RPM", "1/min", "r/min", "min^-1", "min-1", "U/min", "rev per min"]),
    ("rad/s", math.pi / 180.0, ["°/s", "deg/s", "Deg/s", "dps", "deg_per_sec", "deg s-1", "mdeg/ms"]),
    ("rad/s^2", math.pi / 180.0, ["deg/s^2", "°/s²", "deg/s/s", "deg·s⁻²", "deg_s2"]),
    ("rad/s^2", math.pi / 30.0, ["rpm/s"]),
]


@pytest.mark.parametrize(("si", "scale", "spellings"), UNITS)
def test_each_spelling_of_a_unit_has_the_same_value(si: str, scale: float, spellings: list[str]) -> None:
    for unit in spellings:
        assert scale_of(unit, si) == pytest.approx(scale, rel=1e-9), unit
        assert quantities_of(unit) == {si}, unit


@pytest.mark.parametrize(
    "unit", ["MNm", "Nm/A", "N*m*s", "N/m", "kg", "kg*m^2", "1/s", "rads", "in", "m", "N*", "/s", "1", "lbf*in*in"]
)
def test_another_quantity_and_an_ambiguous_unit_have_no_value(unit: str) -> None:
    assert quantities_of(unit) == set()
