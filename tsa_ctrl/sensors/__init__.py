"""Read sensors on serial lines (joint torque, tendon load cells), each in a separate process."""
