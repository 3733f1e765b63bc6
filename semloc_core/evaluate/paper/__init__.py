"""The paper's protocol on one graph (its Tables II and III)."""
