"""Mutants of a module."""
