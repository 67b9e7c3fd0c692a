"""Films as flat scenes: reading them, cutting clips out of them, fitting these to the view."""
