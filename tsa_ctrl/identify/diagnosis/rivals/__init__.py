"""Which other names these logs cannot exclude, by the noise or by the simulation error."""
