"""Pictures and pages from finished results."""
