"""Annotating a video: a person's answers, what is tracked between them, and what to ask next."""
