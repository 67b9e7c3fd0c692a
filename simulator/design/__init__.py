"""Designing masks: patterns, phase retrieval, fabrication, height maps from files, export."""
