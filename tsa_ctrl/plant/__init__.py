"""Simulated drives, joints and sensors as CANopen nodes: the truth that the controller is tried against.

Shares no physics with `tsa_ctrl.model`; reads an actuator model file for its geometry and goes its own way from there.
"""
