"""Hollow organs seen by an endoscope: their walls, their mucosa, the lamps, and segmented surfaces of real ones."""
