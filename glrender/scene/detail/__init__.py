"""Surface detail below the facets of a shape."""
