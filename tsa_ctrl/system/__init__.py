"""The operating system's plumbing: real time, sleep, processes, signals of life, files."""
