"""From a place and what is around it to an embedding: extraction, encoders, and the model that keeps one."""
