"""The commands about one ship: keygen, deploy, rollback, store."""
