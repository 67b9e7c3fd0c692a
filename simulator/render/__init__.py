"""Rendering of RGB and depth with Mitsuba 3."""
