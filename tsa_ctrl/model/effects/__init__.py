"""The catalogue's effects as small pieces, grouped by where they enter; `composition` puts them in order."""
