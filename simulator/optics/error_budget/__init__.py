"""What a PSF stack's errors are: sampling, wavelengths, depth model, planes, directions, each against a reference."""
