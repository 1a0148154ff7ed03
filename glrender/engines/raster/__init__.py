"""OpenGL: meshes, shadow maps, surfaces and products."""
