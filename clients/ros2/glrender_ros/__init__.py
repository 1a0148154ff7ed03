"""A camera node for ROS 2: poses in, images of a glrender server out."""
