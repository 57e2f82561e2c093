"""Fuzz tests: invalid input must not cause a crash, an unpermitted torque or a leak.

campaign/fuzz runs all of them at length.
"""
