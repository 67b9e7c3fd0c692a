"""Parts of a training: its folder, its state, its log, its processes and the loop itself."""
