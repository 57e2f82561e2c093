"""Write the records of the control cycles to log files, and read logs as tables."""
