"""Cameras as calibration reports and ISDs give them: focal planes in millimetres, with lenses from image to ideal."""
