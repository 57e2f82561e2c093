"""Sensors on a serial line (joint torque, tendon load cells), each read in a separate process."""
