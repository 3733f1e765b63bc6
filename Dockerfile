# The node on ROS 2 Jazzy. The environment lies at the same path in both stages, since scripts name its interpreter.
FROM ros:jazzy-ros-base AS build
# Packages of a distribution's release are not pinned one by one (DL3008).
SHELL ["/bin/bash", "-o", "pipefail", "-c"]
# hadolint ignore=DL3008
RUN apt-get update \
    && apt-get install --no-install-recommends -y python3-venv python3-pip ros-jazzy-rosbag2-storage-mcap \
    && rm -rf /var/lib/apt/lists/*
WORKDIR /opt/semloc
COPY pyproject.toml README.md LICENSE constraints.txt ./
COPY tools tools
COPY semloc_core semloc_core
RUN sh tools/ros_venv.sh /usr/bin/python3 .venv
COPY semloc_msgs semloc_msgs
COPY semloc_ros semloc_ros
COPY ros2_ws/src ros2_ws/src
WORKDIR /opt/semloc/ros2_ws
RUN source /opt/ros/jazzy/setup.bash && ../.venv/bin/python -m colcon build --event-handlers console_direct-

FROM ros:jazzy-ros-base
SHELL ["/bin/bash", "-o", "pipefail", "-c"]
# hadolint ignore=DL3008
RUN apt-get update \
    && apt-get install --no-install-recommends -y ros-jazzy-rosbag2-storage-mcap \
    && rm -rf /var/lib/apt/lists/* \
    && useradd --uid 10001 --create-home --shell /bin/bash semloc \
    && install -d -o semloc -g semloc /recorded
COPY --from=build /opt/semloc/.venv /opt/semloc/.venv
COPY --from=build /opt/semloc/ros2_ws/install /opt/semloc/ros2_ws/install
COPY tools/docker_entrypoint.sh /opt/semloc/
COPY models /opt/semloc/models
COPY bags /opt/semloc/bags
USER 10001
WORKDIR /opt/semloc
HEALTHCHECK --interval=30s --timeout=20s --start-period=30s \
    CMD ["/opt/semloc/docker_entrypoint.sh", "bash", "-c", "ros2 lifecycle get /localiser | grep -q '^active'"]
ENTRYPOINT ["/opt/semloc/docker_entrypoint.sh"]
CMD ["ros2", "launch", "semloc_ros", "localiser.launch.py", "map:=/opt/semloc/models/office.map"]
