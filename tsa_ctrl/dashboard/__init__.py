"""`tsa dashboard`: a local page to watch and tune a running daemon, served by a process of its own."""
