"""glrender: headless OpenGL frames for closed-loop navigation around small bodies."""
