"""Test drives of other manufacturers in virtual time: startup, operation and shutdown."""
