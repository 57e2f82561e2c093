"""Measured data that others published: where it lies, its licence, and how it becomes our columns."""
