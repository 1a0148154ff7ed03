"""What puts dust around a body: one file each."""
