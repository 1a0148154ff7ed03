"""Shapes of bodies: files, repair, hull, generated shapes."""
