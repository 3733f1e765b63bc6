"""The page and the picture of one replay."""
