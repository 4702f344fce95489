"""Siamese tracking networks: their two halves, the crops they see, and what is kept between questions."""
