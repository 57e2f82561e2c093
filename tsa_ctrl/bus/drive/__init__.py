"""The nodes before the loop: their kind, the objects written to them, and their answers."""
