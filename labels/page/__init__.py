"""The labelling page: a local web server over one mission and the workspace's label store."""
