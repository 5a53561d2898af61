"""Pictures, tables in a terminal, the HTML report and the app."""
