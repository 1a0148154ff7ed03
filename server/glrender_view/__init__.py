"""A page in the browser that shows the frames of a running server as they come, from a process of its own."""
