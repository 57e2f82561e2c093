"""Nonsense from every side: never may a crash, a torque or a leak come of it; campaign/fuzz runs all at length."""
