"""Launch file: `ros2 launch $(interloc ros --files)/interloc.launch.py points:=/velodyne_points rviz:=true`."""

from pathlib import Path

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, ExecuteProcess
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration, PythonExpression


def generate_launch_description() -> LaunchDescription:
    """Start the node, and RViz where it is wanted."""
    value = LaunchConfiguration
    odom = PythonExpression(["'--odom=' + '", value("odom"), "' if '", value("odom"), "' else '--preset=default'"])
    clock = ["use_sim_time:=", value("use_sim_time")]
    return LaunchDescription(
        [
            DeclareLaunchArgument("points", description="Topic of the point clouds."),
            DeclareLaunchArgument("odom", default_value="", description="Topic of the odometry; else /tf."),
            DeclareLaunchArgument("use_sim_time", default_value="false", description="Whether a bag is the clock."),
            DeclareLaunchArgument("rviz", default_value="false", description="Whether RViz shows it."),
            ExecuteProcess(
                cmd=["interloc", "ros", value("points"), odom, "--", "--ros-args", "-p", clock], output="screen"
            ),
            ExecuteProcess(
                cmd=["rviz2", "-d", str(Path(__file__).parent / "interloc.rviz")], condition=IfCondition(value("rviz"))
            ),
        ]
    )
