"""Studies measure or try out the product; nothing of the product imports them."""
