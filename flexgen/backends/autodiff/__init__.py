"""The functions of a library in JAX and PyTorch: gradients, batches, compiled loops."""
