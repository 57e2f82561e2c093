"""The local socket: a server in a process of its own, and shared memory between it and the loop."""
