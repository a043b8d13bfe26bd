"""`angie evaluate`: generators and baselines on the test clips of a dataset, scored and shown."""
