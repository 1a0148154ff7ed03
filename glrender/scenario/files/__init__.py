"""Files that scenarios are read from: TOML scenario files, CSV tables, CCSDS messages."""
