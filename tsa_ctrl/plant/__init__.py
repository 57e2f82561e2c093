"""Simulate drives, joints and sensors as CANopen nodes: the reference plant for tests of the controller.

The package takes parameters and routing from an actuator model file. It shares no equations with `tsa_ctrl.model`.
"""
