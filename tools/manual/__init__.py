"""Generate the tables of the manual."""
