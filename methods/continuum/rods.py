class Rod: kind="rope"
