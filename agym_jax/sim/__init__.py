"""The simulated scene: (task, robot, human) to a model, and what steps it in MJX or C MuJoCo."""
