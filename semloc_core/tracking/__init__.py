"""From answer to answer: a Bayes filter over the places of a map."""
