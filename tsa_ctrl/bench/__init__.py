"""`tsa bench`: measure the highest rate of this machine, its CAN adapter and a configuration."""
