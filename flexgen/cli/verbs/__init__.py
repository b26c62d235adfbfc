"""The verbs that begin and check a model file of your own."""
