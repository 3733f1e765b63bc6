"""Scene graphs out of what most robots have: 3D detections, odometry or transforms, an occupancy grid. No ROS here."""
