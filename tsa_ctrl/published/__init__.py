"""Fetch measured data that others published, with its licence, and convert it to the columns of a log."""
