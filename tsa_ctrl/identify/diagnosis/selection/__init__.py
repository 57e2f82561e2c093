"""Select causes forward: entry tests, removal, and the detection limit of each effect."""
