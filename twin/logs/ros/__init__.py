"""ROS 2 bags: signals of topics (`sources`), and conversion of a bag to a flight (`bag`)."""
