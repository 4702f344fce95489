"""The live nets of a frame: each target's step, joins, births and ends."""
