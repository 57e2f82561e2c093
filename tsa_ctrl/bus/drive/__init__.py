"""The nodes before the loop: what each is, what is written to it, and what it said."""
