"""The registry of plug-ins, and checks of their results."""
