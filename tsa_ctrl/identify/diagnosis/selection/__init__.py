"""Forward selection of causes: what may enter, what must leave, and how small an effect would have been seen."""
