"""Functions of functions: optimisers that know no body and no image."""
