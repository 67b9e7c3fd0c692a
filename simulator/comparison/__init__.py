"""Mask designs side by side: PSFs, figures of merit and their definitions, as one page or one picture."""
