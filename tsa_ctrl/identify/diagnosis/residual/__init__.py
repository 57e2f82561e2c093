"""Test the residual after the causes are identified: dependence on signals, and changes in time."""
