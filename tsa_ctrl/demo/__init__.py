"""The whole system on one machine: simulated drive and joint, the daemon, a set-point, and what compensation gains."""
