"""Tests with drives of other makers in virtual time: startup, operation and end."""
