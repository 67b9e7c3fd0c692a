"""Things in fast motion: bodies, figures, how they move, deform, bounce and collide, and the rooms they are in."""
