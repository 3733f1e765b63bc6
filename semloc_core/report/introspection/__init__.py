"""The page on a study of explanations."""
