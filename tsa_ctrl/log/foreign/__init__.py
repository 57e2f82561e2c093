"""Tables that other programs wrote: their own names, units, separators, decimal commas and encodings."""
