"""The stress laboratory: turn up one assumption of the paper, and see what every estimator makes of it.

A *study* (``scenes/studies``) names a base scene, one or two *axes* with values, and estimators. At each point of it an
axis' value makes a *situation*; replications are drawn from that, estimated, scored against the truth, and summed up.
"""
