"""Checks that a machine runs on the renderer that it has, and the report of them."""
