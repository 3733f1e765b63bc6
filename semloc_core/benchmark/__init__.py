"""Speed beside the peers: each step timed, and how it grows."""
