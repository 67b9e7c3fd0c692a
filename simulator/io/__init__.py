"""Files of all kinds: OpenEXR, images, tables, JSON; written whole or not at all."""
