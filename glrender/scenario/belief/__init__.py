"""What the on-board side believes of a scene: other shapes, laws, attitudes, cameras and ephemerides than the true."""
