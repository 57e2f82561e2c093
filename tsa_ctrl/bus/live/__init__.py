"""Nodes in the loop: once per SYNC, their answers update a process image and their commands are sent."""
