"""Define the possible causes: the base model with the parameters that recalibration frees, and candidate effects."""
