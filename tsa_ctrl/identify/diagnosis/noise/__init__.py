"""What is not to be explained: coloured noise of the torque, and errors from a direction that no log tells."""
