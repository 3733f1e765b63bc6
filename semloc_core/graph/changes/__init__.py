"""The graph as it changes: the rules of the update stream, updates out of whole graphs, how old what is known is."""
