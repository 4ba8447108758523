"""PPO: rollouts, updates and the agents that learn, on one device or several."""
