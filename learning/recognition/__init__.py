"""Evaluating what recognises: scores, the job, its report and figures."""
