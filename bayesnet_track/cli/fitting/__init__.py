"""The command `fit`: what graphs say about themselves, estimated from videos with ground truth."""
