"""What a map file holds: tables, rows, the hashes that bind it together; how it is written."""
