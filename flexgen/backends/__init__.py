"""The functions of a library on GPUs, in JAX and in PyTorch."""
