"""The speed figures, measured here and now; time and memory of verbs against length of flight."""
