"""Check if this machine can run the loop: kernel, rights, clock, CAN interface, bus load and wake-up latency."""
