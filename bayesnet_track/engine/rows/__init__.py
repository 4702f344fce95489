"""Many targets of one plate as the rows of a table: advanced together, an array operation for all."""
