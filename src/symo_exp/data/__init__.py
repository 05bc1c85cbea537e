"""Trajectories: simulated or recorded, noisy, cached, cut into windows."""
