"""Joint torque that no sensor measures: from the stretch of the tendons, and from the motor's torque alone."""
