"""Model the parts that are not to be explained: coloured noise of the torque, and errors from an unknown direction."""
