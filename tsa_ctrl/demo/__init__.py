"""Run the whole system on one machine: simulated drive and joint, daemon, set-point, and effect of compensation."""
