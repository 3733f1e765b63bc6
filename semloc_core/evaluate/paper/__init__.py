"""The paper's protocol on one graph (its Tables II and III), and how hard the graph is."""
