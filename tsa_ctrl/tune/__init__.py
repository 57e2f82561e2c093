"""Implement `tsa tune`: excite a rig, estimate, verify on another motion, and write the files once the user agrees."""
