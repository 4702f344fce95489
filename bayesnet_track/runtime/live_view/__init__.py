"""A run in progress in the browser: what it is told, what it may ask for, and the server between them."""
