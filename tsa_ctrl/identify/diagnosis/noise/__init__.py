"""Model the errors that need no explanation: coloured noise of the torque, and errors from an unknown direction."""
