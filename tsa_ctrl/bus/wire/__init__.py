"""Frames on a bus, whatever carries them: the seam, its two sides, and the kernel's links. Knows nothing of CANopen."""
