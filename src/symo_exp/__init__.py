"""Learn the dynamics of mechanical systems from trajectories and compare four ways of doing so."""
