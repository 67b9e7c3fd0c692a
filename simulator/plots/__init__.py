"""Every picture that is drawn for people, and the words beside it."""
