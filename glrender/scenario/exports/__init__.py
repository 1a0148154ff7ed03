"""Files that mission tools read, of the states, camera and bodies of a sequence's frames; nothing here draws."""
