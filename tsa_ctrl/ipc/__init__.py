"""The local socket: a server in a separate process, and shared memory between it and the loop."""
