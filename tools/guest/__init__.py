"""A virtual CAN for one command, where the kernel has none a guest that has; standard library only."""
