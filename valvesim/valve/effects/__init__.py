"""The effects of the catalogue, a module a place: an entry declares all that anybody needs to know of its effect."""
