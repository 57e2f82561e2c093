"""The numbers that are shipped, with their intervals, and what they gain on data that no fit has seen."""
