"""Tuning of classical methods: the job, its search, and its study, the file that every other command reads."""
