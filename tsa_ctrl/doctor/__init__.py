"""Is this machine fit to run the loop: kernel, rights, clock, CAN interface, bus load, lateness."""
