"""`tsa bench`: how fast this machine, this adapter and this configuration can go."""
