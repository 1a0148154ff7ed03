"""What to draw, by which engine, and the error to expect: pure functions of views and tolerance."""
