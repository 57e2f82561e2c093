"""`tsa dashboard`: a local page to watch and tune a running daemon, served by a separate process."""
