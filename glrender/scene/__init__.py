"""The parts of a scene that do not change from frame to frame: shapes, bodies, cameras, the sky, the scene file."""
