"""Many variants of one place embedded at once, for whoever asks what would be if: explainers do."""
