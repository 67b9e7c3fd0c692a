"""The commands, a file per subject: thin; each loads a configuration, calls one function and prints what it did."""
