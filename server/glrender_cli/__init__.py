"""The command line `glrender`: its parser, and what its commands share."""
