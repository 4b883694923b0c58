"""Bags: ROS 1 .bag, ROS 2 .db3 and .mcap, read where they lie, message by message."""
