"""The HTTP side of the labelling page: routes, access, and what pages send and get."""
