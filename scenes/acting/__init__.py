"""Hands that act over a table: skeleton and skin, props, the ten actions, the table and its light."""
