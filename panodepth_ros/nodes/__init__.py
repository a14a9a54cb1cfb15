"""The ROS 2 nodes, one file each: declare, subscribe, ask the core, publish."""
