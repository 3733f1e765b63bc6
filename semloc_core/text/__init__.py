"""What is said to a person: shares of a whole, and what holds arrays in a line."""
