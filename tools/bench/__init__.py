"""Benchmarks: time of a cycle and of the model, right answers of diagnosis, calibration and tuning."""
