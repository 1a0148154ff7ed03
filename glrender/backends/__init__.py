"""Built-in plug-ins that draw the same scenes by other means than OpenGL."""
