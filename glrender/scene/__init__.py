"""What does not change from frame to frame: shapes, bodies, cameras, the sky, the scene file."""
