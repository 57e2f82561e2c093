"""The real loop and the real plant in one process under one clock of their own: no bus, no rights, no waiting."""
