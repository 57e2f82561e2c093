"""CANopen master: raw frames in, SI values out. Only this package uses device units and object numbers."""
