"""Figures and the HTML page: what was measured elsewhere, drawn. Nothing here is imported by the node."""
