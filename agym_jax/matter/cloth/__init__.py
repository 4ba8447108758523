"""Cloth: a garment that is held by a gripper and pulled over an arm."""
