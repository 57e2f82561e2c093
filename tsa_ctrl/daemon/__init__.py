"""`tsa run`: child processes, bring-up, the loop, a single shutdown path, and the summary."""
