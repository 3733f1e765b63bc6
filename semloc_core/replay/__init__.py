"""Replay: a recorded run through the localiser, without ROS, and how right its answers were."""
