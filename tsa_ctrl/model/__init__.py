"""The tendon-sheath: equations, model files, the catalogue of effects."""
