"""Mask designs: one file per design, each a function named like its module that returns a Mask."""
