"""Diagnose, choose the motion that separates the open causes, play it, and diagnose again."""
