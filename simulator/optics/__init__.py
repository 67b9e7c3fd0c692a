"""Wave optics: masks, propagation, point spread functions."""
