"""Ways to run a control cycle on a real bus, measured in turns."""
