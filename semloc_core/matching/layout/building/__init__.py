"""One building laid out for verification: the objects around each place, what knowing a spot costs."""
