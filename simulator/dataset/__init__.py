"""Data sets on disk: samples, manifest, jobs, reading and verification."""
