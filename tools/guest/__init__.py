"""Provide a virtual CAN for one command, in a user-mode Linux guest if the kernel does not support it."""
