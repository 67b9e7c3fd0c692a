"""From pictures of a point source at known distances to a measured PSF stack, and what there is to measure again."""
