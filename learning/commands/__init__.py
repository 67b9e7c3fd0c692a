"""Commands that learning adds to `flatlight`."""
