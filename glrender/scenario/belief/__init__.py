"""The on-board side's scene: shapes, laws, attitudes, cameras and ephemerides that differ from the true ones."""
