"""Estimate the joint torque without a sensor, from the tendon elongation or from the motor torque alone."""
