"""What is left once the causes are named: dependence on signals, and changes in time."""
