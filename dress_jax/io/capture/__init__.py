"""Files of other tools and data sets, read into an observation bundle; one module per format."""
