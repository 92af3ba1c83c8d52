"""Maps, films, tables and the page about runs of the closed loop."""
