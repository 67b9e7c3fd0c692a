"""From light at the mask to digital numbers: convolution, shutter, sensor."""
