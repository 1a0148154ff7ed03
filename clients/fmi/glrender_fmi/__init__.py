"""A camera for FMI: what both versions of the standard share. It uses NumPy and `glrender_client` alone."""
