"""The sampled closed loop, feedback laws, observers and commands of position."""
