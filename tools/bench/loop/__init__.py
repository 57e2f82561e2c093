"""Variants of a control cycle on a real bus, measured alternately."""
