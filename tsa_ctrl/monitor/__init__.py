"""Monitor the bus as an independent second channel, and stop the torque on a fault of the loop or of a node."""
