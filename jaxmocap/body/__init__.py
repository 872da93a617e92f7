"""The articulated body: skeleton, pose, kinematics, mass, flesh."""
