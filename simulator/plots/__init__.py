"""Every image that is drawn for people, and the words beside it."""
