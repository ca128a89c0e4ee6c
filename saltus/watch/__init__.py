"""A page in the browser that shows runs while they go on, and recordings of them."""
