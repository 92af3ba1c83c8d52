"""The models that come with tokt, as bundle files."""
