"""Files of many states' frames: drawn by several processes, and gone on with where it was stopped."""
