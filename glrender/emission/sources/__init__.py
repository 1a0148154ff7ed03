"""Sources of the dust around a body, one file each."""
