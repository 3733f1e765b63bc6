"""A map on a Milvus server, changed: written under new generations, then made visible at once."""
