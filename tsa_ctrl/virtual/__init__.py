"""Run the real loop and the real plant in one process with a virtual clock: no bus, no permissions, no waiting."""
