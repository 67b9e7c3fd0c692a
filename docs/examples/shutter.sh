flatlight init --preset video_thesis
flatlight shutter video_thesis.yaml --figures figures
