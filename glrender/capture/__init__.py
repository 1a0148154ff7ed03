"""From irradiance to a detector's frame: motion, stray light, sky, camera model."""
