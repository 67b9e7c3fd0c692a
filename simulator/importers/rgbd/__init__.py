"""Pictures with depth charts: pairing, decoding, cameras and their distortion."""
