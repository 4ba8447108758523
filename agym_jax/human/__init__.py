"""The human: body, sizes, muscles, joint limits, poses, and the population they are drawn from."""
