"""Tests of `tsa live`."""
