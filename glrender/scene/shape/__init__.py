"""Shapes of bodies: files, repair, hull, clusters of facets, generated shapes."""
