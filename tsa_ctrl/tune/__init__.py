"""`tsa tune`: excite a rig, estimate, verify on another motion, and write the model file after a yes."""
