"""Provide a virtual CAN for one command, in a user-mode Linux guest if the kernel has none."""
