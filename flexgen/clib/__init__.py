"""The hand-written C of the emitted library; ``model_`` stands for the library's name."""
