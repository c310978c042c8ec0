"""The real cell: a UR3e, its gripper, and its cameras."""
