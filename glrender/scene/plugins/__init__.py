"""The registry of plug-ins, and checks of what they give."""
