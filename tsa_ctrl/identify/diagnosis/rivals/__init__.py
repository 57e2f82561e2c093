"""Find competing hypotheses: the other effects that the logs cannot exclude in place of an identified cause."""
