"""The bundle: the one file that is shipped, its model card and its signature."""
