"""Readers of shape files that need packages of their own: entry points `glrender.shape`, by the file's ending."""
