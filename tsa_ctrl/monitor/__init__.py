"""An independent second channel: it watches the bus, and takes the torque away when the loop or a node does wrong."""
