"""Measure variants of a control cycle alternately on a real bus."""
