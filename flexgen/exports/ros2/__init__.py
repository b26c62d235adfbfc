"""A ROS 2 package around an emitted library: `export_ros2`."""
