"""`tsa verify-safety`: hang and kill the loop, withhold its heartbeat, and time how the drives take the torque away."""
