"""Estimation: least squares with priors and bounds, covariances from blocks, held-out parts,
statuses.
"""
