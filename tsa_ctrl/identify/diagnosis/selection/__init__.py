"""Select causes one after the other: entry tests, removal, and the detection limit of each effect."""
