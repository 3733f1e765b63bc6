"""The wire: the messages' types, JSON text to typed messages and back, what may be wrong with them, their schemas."""
