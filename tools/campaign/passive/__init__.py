"""Experiments of the runaway campaign, and their evaluation."""
