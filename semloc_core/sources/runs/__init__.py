"""A run on disk: what is one, which updates it has, how one is written."""
