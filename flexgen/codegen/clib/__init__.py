"""The hand-written C of the emitted library; ``model_`` is replaced by the library's name."""
