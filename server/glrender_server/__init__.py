"""The render server: front ends, dispatcher, and the workers that draw."""
