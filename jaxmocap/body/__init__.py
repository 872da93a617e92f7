"""The articulated body: skeleton, pose, kinematics, mass, flesh.

Begin with ``skeleton`` (a ``Tree`` of names, a ``Skeleton`` of numbers) and ``data/human.toml``,
which describes bones, joints and landmarks: a second body is another such file.
``kinematics`` takes a ``Pose`` to the world; ``subject`` and ``proportions`` fit a skeleton to a
person; ``arms`` are what the video step moves; ``model`` joins skeleton, markers and cameras;
``surfaces`` hold the flesh.
"""
