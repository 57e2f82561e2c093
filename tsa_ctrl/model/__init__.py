"""Model the tendon-sheath: equations, model files, catalogue of effects."""
