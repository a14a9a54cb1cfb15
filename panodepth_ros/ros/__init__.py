"""What every node shares: parameter tables, message conversion, quality of service, start-up."""
