"""Drives that others wrote: the variations as data, and one trial of each in virtual time."""
