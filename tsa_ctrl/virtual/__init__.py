"""Run the real loop and the real plant in one process under one virtual clock: no bus, no rights, no waiting."""
