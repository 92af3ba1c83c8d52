"""The commands about models: dataset, train, search, compare, evaluate, models, export."""
