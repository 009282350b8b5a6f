"""What is known of the process in a region: models with covariance, updated from response to response."""
