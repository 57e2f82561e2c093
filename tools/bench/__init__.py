"""Measure the cycle time, the model, the diagnosis, the calibration and the tuning."""
