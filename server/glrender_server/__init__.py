"""The render server: dispatcher, ZeroMQ front end, command line, demo."""
