"""Exact area coverage of visible, sunlit facets."""
