"""The node of ROS 2: node.py is the whole of it; launch file and RViz configuration lie beside it."""
