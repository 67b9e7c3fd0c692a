"""The SceneFlow data sets: stereo frames with disparity, and how that becomes depth."""
