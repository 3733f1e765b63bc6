"""From candidates to an answer: how likely each place is, and whether objects lie around the robot as they do there."""
