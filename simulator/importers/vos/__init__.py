"""Video object segmentation data: frames with masks of the labelled objects."""
