"""How likely an estimated depth is right: calibrated on scenes that are known, and shown to be calibrated on others."""
