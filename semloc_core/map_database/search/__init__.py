"""Search: the places whose embeddings are most like a query's, exactly or by inverted lists."""
