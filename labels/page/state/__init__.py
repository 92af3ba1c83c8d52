"""The server's state: the session, the labels in memory, pictures."""
