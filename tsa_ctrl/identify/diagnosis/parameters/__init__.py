"""The numbers that are reported, with their intervals, and what they gain on data that no fit has seen."""
