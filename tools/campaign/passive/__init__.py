"""The runaway campaign's parts: what is played, and how it is judged."""
