"""What needs navigator, engine and bench together: campaigns over many simulated runs."""
