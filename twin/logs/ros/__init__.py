"""ROS 2 bags: which topic is which signal (`sources`), and how a bag becomes a flight (`bag`)."""
