"""Stock Basilisk flies on glrender: camera images over the protocol that Basilisk speaks with Vizard."""
