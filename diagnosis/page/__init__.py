"""What the report is made of: its words and tables, its arrays, and the page's own HTML, style and script."""
