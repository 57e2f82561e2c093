"""`tsa verify-safety`: hang and kill the loop, withhold its heartbeat, and time the torque removal by the drives."""
