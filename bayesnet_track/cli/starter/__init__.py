"""A first graph for a task: questions, answers, and a commented file made of small pieces."""
