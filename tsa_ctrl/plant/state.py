"""Define the records of the compiled inner loop: parameters and state of one axis. SI units, angles in rad."""

from __future__ import annotations

from enum import IntEnum

import numpy as np

from tsa_ctrl.plant.effects import EFFECT_FIELDS


class Load(IntEnum):
    """List the kinds of load that the joint drives."""

    IMPOSED = 0
    FREE = 1
    SPRING = 2
    WEIGHT = 3
    LIMB = 4  # several joints that move together; the mechanism provides their angles


NATURAL_ELEMENTS = 10  # of the friction build-up by the tendons' elasticity
DELAY_SAMPLES = 8192  # of the delivered torque, one per sub-step

_F = np.float64
_I = np.int64

PARAMETERS = np.dtype(
    [
        # geometry and elasticity
        ("r_m", _F),  # m
        ("r_j", _F),  # m
        ("stiffness", _F),  # E A, N
        ("length", _F),  # l_us, m
        ("series_length", _F),  # E A / k_s, m
        ("series_at_joint", _I),  # the end at which the series spring is
        ("pretension", _F),  # T_p0, N at the nominal bending angle
        ("tendon_stiffness", _F),  # k_t, N/m
        ("bending_arm", _F),  # p + d/2, m (3.50)
        ("friction", _F),  # mu
        ("theta", _F),  # rad
        ("theta_factor", _F),
        ("centre", _F),  # share of a tendon's compliance between the motor and the centre of the bending
        ("presliding", _F),  # m of tendon
        ("distributed", _I),
        # motor
        ("motor_inertia", _F),  # kg*m^2
        ("motor_damping", _F),  # N*m*s/rad
        ("torque_lag", _F),  # s
        ("peak_torque", _F),  # N*m
        # joint and load
        ("load", _I),
        ("load_inertia", _F),  # kg*m^2
        ("load_damping", _F),  # N*m*s/rad
        ("load_stiffness", _F),  # N*m/rad
        ("load_rest", _F),  # rad
        ("weight", _F),  # N*m
        ("weight_phase", _F),  # rad
        ("hand_factor", _F),  # factor on the hand's stiffness and damping
        ("hand_repeat", _I),
        ("push", _F),  # N*m, on the joint from outside
        *EFFECT_FIELDS,
        # faults
        ("torn_a", _I),
        ("torn_b", _I),
        ("pretension_factor", _F),
        # motion and environment
        ("motion_grid", _F),  # s
        ("motion_repeat", _I),
        ("motion_ramp", _F),  # s
        ("step", _F),  # s
    ]
)

STATE = np.dtype(
    [
        ("t", _F),  # s
        ("q_m", _F),
        ("omega_m", _F),
        ("q_j", _F),
        ("omega_j", _F),
        ("acceleration_j", _F),
        ("torque_loop", _F),  # N*m, measured by the current of the drive
        ("tau_m", _F),  # N*m, torque on the motor pulley
        ("t1", _F),
        ("t2", _F),
        ("t3", _F),
        ("t4", _F),
        ("tau_tendon", _F),  # N*m, r_J (T4 - T2)
        ("tau_j", _F),  # N*m, delivered to the load
        ("hand_stiffness", _F),  # N*m/rad
        ("hand_damping", _F),  # N*m*s/rad
        ("hand_angle", _F),  # rad
        ("hand_speed", _F),  # rad/s
        ("taken", _F),  # N*m, value of the plant file's formula
        ("tau_outside", _F),  # N*m, by hand and push on the joint
        ("tau_lagged", _F),  # N*m, the joint torque through the lag of its sensor
        ("tau_sensed", _F),  # N*m, tau_lagged through the sensor's delay
        ("z", _F),  # state of friction in the sheaths, -1 to 1
        ("z_m", _F),  # of the motor's friction
        ("z_j", _F),  # of the joint's load-dependent friction
        ("direction", _F),  # of the joint, for backlash
        ("extreme", _F),  # rad, farthest angle in this direction
        ("reversal", _F),  # rad, angle at the last reversal
        ("in_gap", _I),
        ("q_lagged", _F),
        ("q_m_seen", _F),  # rad, q_m plus the lead of the motor encoder over the tendons
        ("play_side", _F),  # of joint_play, -1 to 1
        ("omega_lagged", _F),
        ("theta", _F),  # mean of both tendons
        ("theta_a", _F),
        ("theta_b", _F),
        ("temperature", _F),
        ("pretension", _F),  # mean of both tendons
        ("pretension_a", _F),
        ("pretension_b", _F),
        ("exchanged", _F),  # s, time of the last exchange of the angles of other joints and of the limb
        ("limb_angle", _F),
        ("limb_speed", _F),
        ("limb_acceleration", _F),
        ("speed_limited", _I),
        ("started", _F),  # s, start of the motion; negative: not started yet
        ("ring_head", _I),
        ("iterations", _I),
        ("unsolved", _I),  # sub-steps whose solution did not converge
        ("beyond", _I),  # 1 once a value left the range in which the arithmetic is exact enough
        ("dissipated", _F),  # J, by friction along the tendons (distributed)
    ]
)

# The largest absolute values for which the equations are solved. No actuator reaches them. Far beyond them, rounding
# errors prevent a solution.
MOST_ANGLE = 1e5  # rad
MOST_SPEED = 1e6  # rad/s
MOST_TENSION = 1e6  # N
