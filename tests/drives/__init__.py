"""Drives that others wrote: what they do at the start, while running and at the end, in virtual time."""
