"""Import tables of other programs, with their own names, units, separators, decimal commas and encodings."""
