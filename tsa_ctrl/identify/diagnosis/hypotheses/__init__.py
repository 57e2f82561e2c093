"""What may be claimed: the base model and what recalibration frees in it, and the catalogue's effects as candidates."""
