"""`tsa run`: children, bring-up, the loop, one shutdown path, and the summary."""
