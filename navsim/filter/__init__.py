"""The filter: states, mechanisation, covariance, measurement models, updates, all kinds of filter, the smoother."""
