"""Logs: the record of one cycle, its way to a file, and the tables read back from files."""
