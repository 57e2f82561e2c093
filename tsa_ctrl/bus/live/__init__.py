"""The nodes in the loop: their answers into a process image, commands out, once per SYNC."""
