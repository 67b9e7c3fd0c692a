"""What a PSF stack's errors are: sampling, depth model, field, spectrum, each against a reference."""
