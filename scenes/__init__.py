"""Scene families: one file or folder per family, each a function named like its module that returns a SceneSource."""
