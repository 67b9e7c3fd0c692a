"""Scene families: one file per family, each a function named like its module that returns a SceneSource."""
