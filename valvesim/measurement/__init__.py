"""Reading measurement files of any kind: one table of columns for each format, one intake for all commands."""
