"""A map on a Milvus server, read: the connection, the collections, rows that are checked."""
