"""The user's own files: meshes with their textures, and pictures on a plane."""
